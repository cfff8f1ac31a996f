"""Libraries from other people's sweeps.

- ``table``     files (.csv, .npz, .h5) -> SweepTable: sizes and complex amplitudes, in any order
- ``imported``  SweepTable -> Library on the grid of a unit cell, its error by cross-validation

In: a file and a :class:`~metafab.spec.cell.UnitCell`. Out: a :class:`~metafab.library.library.Library`.
"""
