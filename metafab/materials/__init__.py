"""Refractive indices n + ik at a wavelength, from cited records with a valid range.

- ``record``     IndexRecord: citation, range, and the index as a formula or a table
- ``catalogue``  a material of a unit-cell file -> its index; the built-in records: formulas, tables in ``tables/*.csv``

In: a :class:`metafab.spec.Material` (numbers, or the name of a record) and a wavelength. Out: the complex index for x
and y polarisation. Outside the range of a record there is an error, never an extrapolation.
"""

from metafab.materials.catalogue import records, refractive_index
from metafab.materials.record import IndexRecord

__all__ = ["refractive_index", "records", "IndexRecord"]
