"""Figures that the steps of a run compute and store: the entries of ``summary.json`` and of the steps' own files.

They are defined below the packages that compute them, so that a run without stale steps imports none of these packages.

- ``library``  build of a library, its models, its quality
- ``mask``     target phases, the pillars that follow them, writing time
- ``light``    overlap and losses, aberrations, focus, diffraction orders, tolerances
- ``image``    decoded images and their segments
"""

from metafab.core.figures.image import DecodingFigures, SegmentFigures
from metafab.core.figures.library import BuildStatistics, CornerStatistics, LineStatistics, Quality
from metafab.core.figures.light import (
    AberrationFigures,
    FocusFigures,
    Loss,
    OrderFigures,
    OrdersFigures,
    SpaceVariance,
    ToleranceRow,
    ToleranceTable,
    Wavefront,
)
from metafab.core.figures.mask import LightMapping, MappingFigures, PhaseFigures, Remedy, WriteTime

__all__ = [
    "BuildStatistics",
    "CornerStatistics",
    "LineStatistics",
    "Quality",
    "PhaseFigures",
    "Remedy",
    "MappingFigures",
    "LightMapping",
    "WriteTime",
    "Wavefront",
    "Loss",
    "SpaceVariance",
    "AberrationFigures",
    "FocusFigures",
    "OrderFigures",
    "OrdersFigures",
    "ToleranceRow",
    "ToleranceTable",
    "SegmentFigures",
    "DecodingFigures",
]
