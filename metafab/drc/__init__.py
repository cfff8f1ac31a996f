"""Design rules on a written file.

- ``report``      DrcReport: counts, places; JSON and KLayout's report database
- ``lattice``     all rules on the pillars read back, exact
- ``rectangles``  the geometric rules on the file's rectangles, whatever lattice they came from
- ``rows``        which of them stand near each other
- ``polygons``    the geometric rules by KLayout, independent of lattices
- ``check``       any engine on a file

In: a mask file and a Design. Out: a DrcReport.
"""

from metafab.drc.check import check
from metafab.drc.report import RULES, DrcReport, Marker, save

__all__ = ["RULES", "DrcReport", "Marker", "check", "save"]
