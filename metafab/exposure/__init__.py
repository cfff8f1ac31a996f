"""Electron exposure of a mask: energy in the resist, printed sizes, proximity-effect correction.

- ``electrons``  the beam's point-spread function: presets, terms, tables, Monte Carlo simulation
- ``energy``     energy in the resist at every pillar of a lens
- ``printing``   printed edges by the threshold model
- ``correction``  corrected doses of several lenses, and their classes
- ``sums``       compiled loops over pillars
- ``prediction``  printed sizes of all pillars: statistics, map, process window
- ``beside_lens``  shapes of a mask beside a lens: other copies, frame, text, test structures
- ``shape``      sizes to draw at one dose
- ``etch``       sizes after the etch: bias and microloading
- ``expose``     :func:`expose`: printed sizes, corrected doses, dose classes
- ``results``    what an exposure finds; ``exposure.json``
- ``size_model``  sizes of measured pillars as functions of a process
- ``fit``        process from measured sizes
- ``process_file``  table of measured sizes to process file

In: a :class:`~metafab.layout.pillars.PillarMap` of drawn rectangles and a :class:`BeamPsf`. Out: an :class:`Exposure`.
Energies are relative to that of a large pad at the base dose, or to the clearing energy where stated.
"""

from metafab.exposure.electrons.beam import BeamPsf
from metafab.exposure.electrons.process import beam_psf
from metafab.exposure.electrons.process import exposure_process as exposure_process
from metafab.exposure.energy.beside import Beside as Beside
from metafab.exposure.energy.beside import OtherLens as OtherLens
from metafab.exposure.energy.resist import ResistEnergy
from metafab.exposure.expose import (
    ExposedLens,
    ExposureNumerics,
    expose,
    expose_lenses,
)
from metafab.exposure.results import Exposure, ExposureFigures
from metafab.exposure.results import ExposureRecord as ExposureRecord
from metafab.exposure.results import SampledPillar as SampledPillar
from metafab.exposure.results import SizeErrors as SizeErrors
from metafab.exposure.results import load_record as load_record
from metafab.exposure.results import save_record as save_record
from metafab.spec.mask import BeamTerm

__all__ = [
    "expose",
    "expose_lenses",
    "Exposure",
    "ExposureNumerics",
    "ExposureFigures",
    "beam_psf",
    "BeamPsf",
    "BeamTerm",
    "ExposedLens",
    "ResistEnergy",
]
