"""Shapes of a mask file, independent of its format.

- ``hierarchy``: cells and references -> a stream of rectangles and other shapes
- ``recover``: pillars among the shapes; rectangles -> sizes at lattice sites, and leftovers
"""
