"""GDSII Stream format 6.

- ``records``: kinds of records, and their bytes
- ``writer``: tiles -> file
- ``runs``: records of a file, runs of like elements, and rings of five points as rectangles
- ``doses``: a file whose datatypes are doses
- ``reader``: file -> cells
"""
