"""Design rules on a written file.

In: a mask file and a :class:`~metafab.spec.Design`. Out: a :class:`DrcReport`.

- ``rules``: the rules, and their limits in units of a file
- ``report``: violations, their places; JSON and KLayout's report database
- ``lattice``: all rules on the pillars read back, exact; the gap rule in ``_check_gaps``
- ``rectangles``: geometric rules on the rectangles of a file, without a lattice
- ``rows``: pairs of rectangles that are near each other
- ``polygons``: geometric rules by KLayout, as an independent check
- ``check``: any of these engines on a file
"""

from metafab.drc.check import check
from metafab.drc.report import DrcReport, Marker, save
from metafab.drc.rules import RULES

__all__ = ["check", "DrcReport", "Marker", "save", "RULES"]
