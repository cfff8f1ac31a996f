"""OASIS (SEMI P39).

- ``elements``: integers, reals, strings, displacements, repetitions and point lists, written and read
- ``records``: pillars of a tile -> RECTANGLE and POLYGON records, deflated
- ``writer``: tiles -> file
- ``shapes``: geometry records -> corners; modal variables
- ``rectangles``: runs of RECTANGLE records -> rectangles, compiled
- ``reader``: file -> cells
"""
