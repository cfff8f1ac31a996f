"""Shapes of a mask file, independent of its format.

- ``hierarchy``: cells and references -> a stream of rectangles and other shapes
- ``known``: pillars among the shapes
- ``recover``: rectangles -> sizes at lattice sites, and leftovers
"""
