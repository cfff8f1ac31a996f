"""Field of the pillars of a mask among their neighbours, by open chains along its rows and its columns.

- ``size_tables``  a chain's polynomials at the sizes of a mask
- ``open_lines``   field along open chains, and its derivatives by the sizes
- ``windows``      field of a window of a mask: chains along x and along y
- ``choice``       sizes chosen for the field among neighbours
"""
