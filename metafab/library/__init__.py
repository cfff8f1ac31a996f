"""A sweep over width and length -> Library: complex t and r of every manufacturable size, each with an error bound.

- ``fit/``     rational models of the amplitudes, and the error bounds that follow from them
- ``sweep/``   adaptive sampling and checkpoints: UnitCell -> Library
- ``foreign/`` sweeps of other programs
- ``use/``     target phases -> sizes, figures of merit, checks
- ``neighbours/``  fields of unlike pillars side by side: chains of coupled modes
- ``axes``     corners of a sweep (wavelength, height, walls, bias, index, angle), cells and models there
- ``surface``  continuous evaluation at millions of sizes per second
- ``library``  Library: values on the grid of sizes, ``library.at(wavelength_nm=803.0)``, ``library.surface``
- ``store``    save and load (HDF5)
- ``built``    library files with the model of neighbours that their unit cell asks for

In: a :class:`~metafab.spec.cell.UnitCell` and an executor. Out: a :class:`Library`, and the :class:`SizeTable` that
maps target phases to sizes.
"""

from typing import TYPE_CHECKING

from metafab.core.further import further_names
from metafab.library.built import build_file, is_current
from metafab.library.library import Library, evaluate
from metafab.library.store import load, save
from metafab.library.sweep.build import build, expected_cells
from metafab.library.use.check import check
from metafab.library.use.error_terms import index_phase_error_rad
from metafab.library.use.lookup import SizeTable, build_size_table
from metafab.library.use.quality import quality

__all__ = [
    "build",
    "load",
    "Library",
    "save",
    "evaluate",
    "check",
    "quality",
    "build_file",
    "is_current",
    "expected_cells",
    "SizeTable",
    "build_size_table",
    "index_phase_error_rad",
]

if not TYPE_CHECKING:
    __getattr__ = further_names(
        __name__,
        {
            "metafab.library.surface": "SizeResponse Surface",
            "metafab.library.use.check": "LibraryCheck",
            "metafab.library.use.lookup": "global_offsets",
            "metafab.library.use.quality": "coverage_rad",
        },
    )
