"""Point-spread functions (PSFs) of written pillars and of target phases over depth and field, each with its error.

- ``stack``                :func:`psf`: the pair of PSFs over depth and field
- ``polarisation_states``  :func:`~metafab.optics.polarisation_states.stokes_psf`: PSFs of six states of polarisation
- ``numerics``             PsfNumerics: window, target error and filter; valid inputs
- ``depth_target``         numerics for a wanted error of depth
- ``point_spread``         Psf, the result, with PsfField and PsfDetails
- ``store``                ``psf.h5``
- ``stack_files``          pictures of a point in files of other programs
- ``measured_stack``       :func:`~metafab.optics.measured_stack.psf_of_stack`: the pair of such pictures
- ``geometry``             lens and sensor, substrate, path lengths
- ``sources``              the field behind the metasurface, apodisation
- ``propagation``          block sums of the pillars, and their propagation to the sensor
- ``interpolation``        between depths and directions; join stacks, select depths
- ``measures``             main lobe, focus, efficiency, modulation transfer, loss chain, aberrations over the field,
                           and where light lands that misses its window

In: a :class:`~metafab.layout.pillars.PillarMap` with its :class:`~metafab.library.library.Library`, or a
:class:`~metafab.phase.terms.profile.PhaseProfile`; an :class:`Imaging`. Out: a :class:`Psf`.
"""

from typing import TYPE_CHECKING

from metafab.core.further import further_names
from metafab.optics.geometry.imaging import Imaging
from metafab.optics.geometry.imaging import depth_nodes as depth_nodes
from metafab.optics.geometry.imaging import field_tangents as field_tangents
from metafab.optics.geometry.plate import Plate as Plate
from metafab.optics.interpolation import at_depths, at_tangent
from metafab.optics.numerics import PsfNumerics
from metafab.optics.point_spread import Psf
from metafab.optics.propagation.image import relative_l2 as relative_l2
from metafab.optics.sources.neighbours import NeighbourField as NeighbourField
from metafab.optics.sources.neighbours import neighbour_field
from metafab.optics.sources.source import Apodisation as Apodisation
from metafab.optics.sources.source import Source as Source
from metafab.optics.sources.source import WrittenField as WrittenField
from metafab.optics.sources.source import apodised as apodised
from metafab.optics.sources.source import (
    ideal_field,
    made_field,
    written_field,
)
from metafab.optics.stack import psf
from metafab.optics.store import load, save

__all__ = [
    "psf",
    "Psf",
    "Imaging",
    "PsfNumerics",
    "written_field",
    "ideal_field",
    "made_field",
    "neighbour_field",
    "at_depths",
    "at_tangent",
    "load",
    "save",
]

if not TYPE_CHECKING:
    __getattr__ = further_names(
        __name__,
        {
            "metafab.information.fisher": "depth_crlb_m point_information twin_depth_information",
            "metafab.information.texture": "PointSource",
            "metafab.optics.interpolation": "concatenate without_depths",
            "metafab.optics.measures.chain": "Loss Wavefront loss_chain wavefront",
            "metafab.optics.measures.metrics": "main_lobe_px orientation_deg",
            "metafab.optics.measures.mtf": "lens_modulation modulation_transfer",
            "metafab.optics.measures.space_variance": "SpaceVariance aberration_dioptre space_variance",
            "metafab.optics.point_spread": "PsfField",
            "metafab.optics.sources.source": "ApodisedField IdealField",
        },
    )
