"""PillarMap -> mask files, and back from the file.

In: a :class:`~metafab.layout.PillarMap` and a :class:`~metafab.spec.Design`. Out: GDSII and OASIS files. In: such a
file, by whatever software. Out: a :class:`ReadBack` with the pillars and every shape that is not a pillar.

- ``write``: all files of a mask, in one pass over the tiles
- ``sidecar``: the files next to the mask: counts, areas, write time (``layout.json``); layer names (``layout.lyp``)
- ``plan``: seconds, bytes and core-hours of a layout, from a sample of tiles
- ``read``: a file -> pillars at lattice sites, or its bare shapes
- ``budget``: memory and time that reading a file may take
- ``measured``: measured sizes of pillars, from a table
- ``writing``: fracture into shots, write time, order of the write fields
- ``exchange``: pillars of a gdstk cell
- ``turned``: turned pillars of a file
- ``drawing``: independent of the format: cells, copies, dose classes, the inverted field, chip features
- ``shapes``: cells, references and shapes of a file, and the pillars among them
- ``gdsii``, ``oasis``: the two formats
"""

from typing import TYPE_CHECKING

from metafab.core.further import further_names
from metafab.mask.drawing.cells import top_name
from metafab.mask.drawing.include import shapes_beside
from metafab.mask.exchange import from_gdstk
from metafab.mask.plan import announcement, plan
from metafab.mask.read import ReadBack, read, read_shapes, read_shared
from metafab.mask.write import WrittenFile, biased, table_names, write

__all__ = [
    "write",
    "read",
    "ReadBack",
    "WrittenFile",
    "plan",
    "from_gdstk",
    "read_shapes",
    "read_shared",
    "biased",
    "announcement",
    "shapes_beside",
    "table_names",
    "top_name",
]

if not TYPE_CHECKING:
    __getattr__ = further_names(__name__, {"metafab.mask.read": "Shapes", "metafab.mask.shapes.recover": "Leftover"})
