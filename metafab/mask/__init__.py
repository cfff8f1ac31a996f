"""PillarMap -> mask files, and back again from the file.

- ``cells``         names and places of the cells, and what is stamped on their sites
- ``copies``        several lenses on a chip
- ``inverse``       the field around the pillars, as rectangles
- ``varints``       OASIS integers
- ``writer``        what both formats share
- ``oasis_records`` a tile of pillars -> OASIS rectangles, deflated
- ``oasis_writer``  OASIS by streaming
- ``gdsii_writer``  GDSII by streaming
- ``font``          letters as rectangles
- ``surroundings``  write field, marks, frame, label, dicing street
- ``dose``          dose classes by size or density
- ``exposure``      write time
- ``viewer``        layer properties for KLayout
- ``write``         all files of a mask in one pass
- ``plan``          what a layout will cost, from a sample of tiles
- ``hierarchy``     cells and references -> rectangles
- ``known``         which shapes are pillars
- ``gdsii_window``  records of GDSII, and runs of like elements
- ``gdsii_rectangles`` rings of five points -> rectangles
- ``gdsii_reader``  GDSII -> cells
- ``oasis_stream``  the elements of OASIS records
- ``oasis_shapes``  what the geometry records of OASIS draw
- ``oasis_rectangles`` runs of RECTANGLE records -> rectangles
- ``oasis_reader``  OASIS -> cells
- ``recover``       rectangles -> sizes at lattice sites, and leftovers
- ``read``          a file -> ReadBack, or its bare shapes

In: a PillarMap and a Design. Out: files; from a file: a ReadBack, the pillars and everything that is none.
"""

from metafab.mask.drawing.cells import top_name
from metafab.mask.drawing.copies import lens_copies
from metafab.mask.plan import announcement, plan
from metafab.mask.read import Leftover, ReadBack, Shapes, read, read_shapes
from metafab.mask.write import WrittenFile, biased, write

__all__ = [
    "Leftover",
    "ReadBack",
    "Shapes",
    "WrittenFile",
    "announcement",
    "biased",
    "lens_copies",
    "plan",
    "read",
    "read_shapes",
    "top_name",
    "write",
]
