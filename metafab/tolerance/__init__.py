"""Effect of fabrication faults on the PSFs, efficiency, extinction and decoded depth of a written mask.

- ``corners``     amplitudes of a mask with another height, index, sidewall or bias, from a few solved cells
- ``corner_fit``  their change, fitted to the solved sizes
- ``scatter``     random faults of block sums: misplaced and missing pillars, stitched write fields
- ``mask_light``  PSFs of a mask from blocks of pillars of fixed size
- ``reference``   figures of a mask against the nominal one, decoded depth included
- ``study``       :func:`tolerance_table`: all corners and faults against the nominal mask; ``tolerance.json``

In: a :class:`~metafab.optics.WrittenField` with its library, the tolerances of a design and the
:class:`PsfConditions` of the comparison. Out: a :class:`ToleranceTable`.
"""

from metafab.core.figures import ToleranceRow, ToleranceTable
from metafab.tolerance.corners import CornerField, corner_fields, fields_at
from metafab.tolerance.mask_light import PsfConditions
from metafab.tolerance.study import load_tolerance, save_tolerance, tolerance_table

__all__ = [
    "tolerance_table",
    "PsfConditions",
    "ToleranceTable",
    "ToleranceRow",
    "corner_fields",
    "fields_at",
    "CornerField",
    "load_tolerance",
    "save_tolerance",
]
