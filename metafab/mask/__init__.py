"""PillarMap -> mask files, and back again from the file.

- ``cells``         names and places of the cells
- ``varints``       OASIS integers
- ``oasis_writer``  OASIS by streaming
- ``gdsii_writer``  GDSII by streaming
- ``viewer``        layer properties for KLayout
- ``write``         all files of a mask in one pass

In: a PillarMap and a Design. Out: files; from a file: a ReadBack, the pillars and everything that is none.
"""

from metafab.mask.write import WrittenFile, write

__all__ = ["WrittenFile", "write"]
