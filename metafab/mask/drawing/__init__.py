"""Drawing, independent of the format: PillarMap and Design -> cells, stamps, rectangles in database units.

- ``scan``: pillars of a tile sorted by size
- ``cells``: cells of tiles, and the shapes that are stamped on their sites
- ``copies``: several lenses on a chip
- ``dose``: dose classes by size or density
- ``inverse``: the field around the pillars, as rectangles
- ``stamps``: all shapes on the sites of a lens
- ``font``: letters as rectangles
- ``surroundings``: write field, marks, frame, label, dicing street, test structures
- ``include``: cells of other files
- ``kit``: test structures
- ``clearance``: distances between the lenses and everything beside them
- ``cell_writer``: streaming of tiles into a file, for both formats
"""
