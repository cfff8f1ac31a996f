"""Electron exposure of a mask: energy in the resist, printed sizes, proximity-effect correction.

- ``beam``         BeamPsf: the beam's point-spread function as a sum of Gaussians
- ``monte_carlo``  electrons in a stack of layers: radial energy density in the resist
- ``presets``      point-spread functions of usual processes
- ``process``      point-spread function of a design's ``[process.exposure]``
- ``near``         energy of the 3 x 3 nearest pillars, in closed form
- ``far``          energy from farther pillars, by Fourier transforms
- ``resist``       ResistEnergy: energy at every pillar of a lens, tile by tile, and as a direct sum
- ``printing``     printed edges by the threshold model
- ``sums``         compiled loops over pillars
- ``expose``       :func:`expose`: printed sizes, corrected doses, dose classes

In: a :class:`~metafab.layout.pillars.PillarMap` of drawn rectangles and a :class:`BeamPsf`. Out: an :class:`Exposure`.
Energies are relative to that of a large pad at the base dose, or to the clearing energy where stated.
"""

from metafab.exposure.beam import BeamPsf, BeamTerm
from metafab.exposure.expose import Exposure, ExposureFigures, ExposureNumerics, SampledPillar, expose
from metafab.exposure.process import beam_psf
from metafab.exposure.resist import ResistEnergy

__all__ = [
    "BeamPsf",
    "BeamTerm",
    "Exposure",
    "ExposureFigures",
    "ExposureNumerics",
    "ResistEnergy",
    "SampledPillar",
    "beam_psf",
    "expose",
]
