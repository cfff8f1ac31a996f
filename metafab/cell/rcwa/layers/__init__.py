"""Maxwell's equations of one layer as matrices P and Q: symmetry class and permittivities in, two matrices out.

- ``factorisation``  one rectangle by Li's factorisation rules
- ``nested``         crosses, rounded corners and ellipses as nested rectangles
- ``staggered``      two rectangles of a hexagonal lattice
- ``tangents``       derivatives of P and Q by the sizes and the index of one rectangle
"""
