"""A sweep over width and length -> Library: complex t and r of every manufacturable size, each with its error.

- ``library``  Library: values on the grid of sizes, and where they come from
- ``lookup``   target phases -> size index: best field overlap over the (phi_x, phi_y) torus

In: a UnitCell and an executor. Out: a Library, which ``lookup`` turns into the table that a layout maps with.
"""

from metafab.library.library import Library, SizeResponse
from metafab.library.lookup import SizeTable, build_size_table, global_offsets

__all__ = ["Library", "SizeResponse", "SizeTable", "build_size_table", "global_offsets"]
