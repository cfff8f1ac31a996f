"""What faults of fabrication do to PSFs, efficiency and depth."""

from metafab.tolerance.corners import CornerField, corner_fields
from metafab.tolerance.fabrication import ThinnedField, misplaced, stitched
from metafab.tolerance.store import load_tolerance, save_tolerance, tolerance_figures
from metafab.tolerance.table import ToleranceRow, ToleranceTable, tolerance_table

__all__ = [
    "CornerField",
    "ThinnedField",
    "ToleranceRow",
    "ToleranceTable",
    "corner_fields",
    "load_tolerance",
    "misplaced",
    "save_tolerance",
    "stitched",
    "tolerance_figures",
    "tolerance_table",
]
