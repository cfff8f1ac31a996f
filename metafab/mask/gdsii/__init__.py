"""GDSII Stream format 6.

- ``records``: kinds of records, and their bytes
- ``writer``: tiles -> file, also with doses as datatypes
- ``runs``: records of a file, runs of like elements, and rings of five points as rectangles
- ``reader``: file -> cells
"""
