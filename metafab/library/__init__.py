"""A sweep over width and length -> Library: complex t and r of every manufacturable size, each with its error.

Building, from the bottom up:

- ``sampling``    the grid of sizes, and which of them to solve
- ``rational``    amplitudes as N/D with common poles, fitted to scattered samples
- ``models``      all amplitudes, fitted in pairs whose disagreement shows the error
- ``certificate`` from disagreement and the solver's errors to the error that is stated at every size
- ``checkpoint``  solved sizes on disk as they arrive
- ``rounds``      solve, fit, test on held-out sizes, and again
- ``between``     the same off the grid, where a resonance, true or false, is narrower than a step
- ``steep``       and where amplitudes are so steep that no solved size can vouch for them
- ``axes``        what else a sweep covers (wavelength, height, walls, bias, index, angle), and the cells there
- ``corner_model``  one rational model over sizes and axes
- ``corner_rounds`` the same rounds for it, only where axes are asked
- ``foresight``   what a build will take
- ``build``       UnitCell -> Library, in memory or as a file

Using:

- ``library``     Library: values on the grid of sizes, and where they come from
- ``corners``     the library at other values of its axes: ``library.at(wavelength_nm=803.0)``
- ``store``       save, load (HDF5)
- ``spline``      bicubic B-splines on tiles, each as fine as it must be
- ``surface``     continuous evaluation at millions of sizes a second
- ``lookup``      target phases -> size index: best field overlap over the (phi_x, phi_y) torus
- ``quality``     coverage, holes, transmittance, sensitivity
- ``check``       held-out sizes against a finer or another solver
- ``index_error`` what the uncertainty of the pillar's index does to the phases

A library's file is of format 1: the grid of sizes, ``/model`` where it is continuous, ``/corners`` where it has axes.
Readers take what is there, so files without the later groups load for ever.

In: a UnitCell and an executor. Out: a Library, which ``lookup`` turns into the table that a layout maps with.
"""

from metafab.library.library import Library, SizeResponse
from metafab.library.store import is_current, load, save
from metafab.library.surface import Surface, evaluate
from metafab.library.sweep.build import SOLVER_SHARE, build, build_file
from metafab.library.sweep.foresight import Foresight, foresee
from metafab.library.use.check import LibraryCheck, check
from metafab.library.use.index_error import index_phase_error_rad
from metafab.library.use.lookup import SizeTable, build_size_table, global_offsets
from metafab.library.use.quality import coverage_rad, quality

__all__ = [
    "SOLVER_SHARE",
    "Foresight",
    "Library",
    "LibraryCheck",
    "SizeResponse",
    "SizeTable",
    "Surface",
    "build",
    "build_file",
    "build_size_table",
    "check",
    "coverage_rad",
    "evaluate",
    "foresee",
    "global_offsets",
    "index_phase_error_rad",
    "is_current",
    "load",
    "quality",
    "save",
]
