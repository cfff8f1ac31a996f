"""Written pillars and their library -> point-spread functions over depth and field, each with its error.

- ``imaging``      Imaging: geometry of lens and sensor; image points by the grating law; nodes over depth, field
- ``source``       what leaves the metasurface: pillars through a library, or target phases
- ``path``         exact path lengths and amplitudes from object over lens to sensor
- ``pupil``        Pupil: a streaming pass from pillars to block sums
- ``chebyshev``    interpolation between Chebyshev points
- ``blocks``       block size chosen by the error asked
- ``refocus``      block sums behind another ray: other depths, directions, wavelengths
- ``kernel``       propagation to one window: a separable transform and a low-rank rest
- ``window``       block sums -> field on a window: matrix Fourier transforms
- ``image``        irradiance on a window and its error; large windows in panels, by a cost model
- ``stack``        :func:`psf`: the pair over depth and field
- ``band``         the pair in the light of a filter: few wavelengths, shifted and added
- ``lobe``         main lobe to a fraction of a pixel, orientation
- ``field``        interpolation over the field of view
- ``depth``        interpolation between depths, joining stacks
- ``metrics``      efficiency through a pinhole, peaks, rotation, MTF, depth of field
- ``point_spread`` Psf, PsfField: what goes out
- ``fabrication``  corners of fabrication: moved, missing and mis-sized pillars in one table
- ``fisher``       Fisher information about depth in PSF stacks, and the Cramer-Rao bound
- ``store``        ``psf.h5``
- ``reference``    the direct Rayleigh-Sommerfeld sum over all sites that checks the rest

In: a :class:`~metafab.layout.pillars.PillarMap` with its :class:`~metafab.library.library.Library`, or a
:class:`~metafab.phase.profile.PhaseProfile`; an :class:`Imaging`. Out: a :class:`Psf`.
"""

from metafab.optics import metrics
from metafab.optics.depth import at_depths, concatenate, without_depths
from metafab.optics.fabrication import ThinnedField, ToleranceRow, library_corners, misplaced, stitched, tolerance
from metafab.optics.field import at_tangent
from metafab.optics.fisher import PointSource, depth_crlb_m, point_information, twin_depth_information
from metafab.optics.image import relative_l2
from metafab.optics.imaging import Imaging, depth_nodes, field_tangents
from metafab.optics.lobe import main_lobe_px, orientation_deg
from metafab.optics.point_spread import Psf, PsfField
from metafab.optics.reference import direct_irradiance
from metafab.optics.source import IdealField, Source, WrittenField, ideal_field, written_field
from metafab.optics.stack import psf
from metafab.optics.store import load, save

__all__ = [
    "IdealField",
    "Imaging",
    "PointSource",
    "Psf",
    "PsfField",
    "Source",
    "ThinnedField",
    "ToleranceRow",
    "WrittenField",
    "at_depths",
    "at_tangent",
    "concatenate",
    "depth_crlb_m",
    "depth_nodes",
    "direct_irradiance",
    "field_tangents",
    "ideal_field",
    "library_corners",
    "load",
    "main_lobe_px",
    "metrics",
    "misplaced",
    "orientation_deg",
    "point_information",
    "psf",
    "relative_l2",
    "save",
    "stitched",
    "tolerance",
    "twin_depth_information",
    "without_depths",
    "written_field",
]
