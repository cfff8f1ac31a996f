"""Written pillars and their library -> point-spread functions over depth and field, each with its error.

- ``imaging``      Imaging: geometry of lens and sensor; image points by the grating law; nodes over depth, field
- ``source``       what leaves the metasurface: pillars through a library, or target phases
- ``apodisation``  a stop and an amplitude in the plane of the pillars
- ``plate``        the substrate between scene and pillars
- ``path``         exact path lengths and amplitudes from object over lens to sensor
- ``pupil``        Pupil: a streaming pass from pillars to block sums
- ``chebyshev``    interpolation between Chebyshev points
- ``blocks``       block size chosen by the error asked
- ``refocus``      block sums behind another ray: other depths, directions, wavelengths
- ``kernel``       propagation to one window: a separable transform and a low-rank rest
- ``window``       block sums -> field on a window: matrix Fourier transforms
- ``image``        irradiance on a window and its error; large windows in panels, by a cost model
- ``asked``        what may be asked of a stack; the rest refused
- ``stack``        :func:`psf`: the pair over depth and field
- ``band``         the pair in the light of a filter: few wavelengths, shifted and added
- ``lobe``         main lobe to a fraction of a pixel, orientation
- ``field``        interpolation over the field of view
- ``depth``        interpolation between depths, joining stacks
- ``basis``        PsfBasis: few images and smooth weights that carry a stack over depth and field
- ``metrics``      efficiency through a pinhole, peaks, rotation, depth of field
- ``mtf``          modulation transfer, of the pair and of a standard lens
- ``chain``        where the light goes: factors from the aperture through the pinhole
- ``space_variance``  image points, aberrations and depth bias over the field of view
- ``point_spread`` Psf, PsfField: what goes out
- ``fabrication``  faulty masks pillar by pillar: moved and missing ones
- ``scatter``      the same faults on block sums
- ``corners``      pillars of another height, index, wall or bias, from few solved cells
- ``tolerance``    what corners and faults do: PSFs, efficiency, extinction, depth, in one table
- ``tolerance_store``  ``tolerance.json``
- ``fisher``       Fisher information about depth in PSF stacks, and the Cramer-Rao bound
- ``store``        ``psf.h5``
- ``reference``    the direct Rayleigh-Sommerfeld sum over all sites that checks the rest
- ``spectrum``     the angular spectrum of a small lens: a second reference, and where all the power goes

In: a :class:`~metafab.layout.pillars.PillarMap` with its :class:`~metafab.library.library.Library`, or a
:class:`~metafab.phase.terms.profile.PhaseProfile`; an :class:`Imaging`. Out: a :class:`Psf`.
"""

from metafab.information import PointSource, depth_crlb_m, point_information, twin_depth_information
from metafab.optics.geometry.imaging import Imaging, depth_nodes, field_tangents
from metafab.optics.geometry.plate import Plate
from metafab.optics.interpolation.basis import PsfBasis
from metafab.optics.interpolation.depth import at_depths, concatenate, without_depths
from metafab.optics.interpolation.field import at_tangent
from metafab.optics.measures import metrics
from metafab.optics.measures.chain import Loss, Wavefront, loss_chain, wavefront
from metafab.optics.measures.lobe import main_lobe_px, orientation_deg
from metafab.optics.measures.mtf import lens_modulation, modulation_transfer
from metafab.optics.measures.space_variance import SpaceVariance, aberration_dioptre, seen_bias_dioptre, space_variance
from metafab.optics.point_spread import Psf, PsfField
from metafab.optics.propagation.image import relative_l2
from metafab.optics.reference.angular_spectrum import AngularSpectrum
from metafab.optics.reference.direct_sum import direct_irradiance
from metafab.optics.sources.apodisation import Apodisation, apodised
from metafab.optics.sources.source import ApodisedField, IdealField, Source, WrittenField, ideal_field, written_field
from metafab.optics.stack import psf
from metafab.optics.store import load, save

__all__ = [
    "AngularSpectrum",
    "Apodisation",
    "ApodisedField",
    "IdealField",
    "Imaging",
    "Loss",
    "Plate",
    "PointSource",
    "Psf",
    "PsfBasis",
    "PsfField",
    "Source",
    "SpaceVariance",
    "Wavefront",
    "WrittenField",
    "aberration_dioptre",
    "apodised",
    "at_depths",
    "at_tangent",
    "concatenate",
    "depth_crlb_m",
    "depth_nodes",
    "direct_irradiance",
    "field_tangents",
    "ideal_field",
    "lens_modulation",
    "load",
    "loss_chain",
    "main_lobe_px",
    "metrics",
    "modulation_transfer",
    "orientation_deg",
    "point_information",
    "psf",
    "relative_l2",
    "save",
    "seen_bias_dioptre",
    "space_variance",
    "twin_depth_information",
    "wavefront",
    "without_depths",
    "written_field",
]
