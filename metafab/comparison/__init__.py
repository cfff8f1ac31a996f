"""Comparison of a design's camera with others of equal aperture, light and sensor: depth and sharpness over depth.

- ``rivals``  the cameras: the design, its lens without a helix, and a double helix, with their PSFs
- ``study``   photographs of planes by all cameras, the errors of their depth estimates, ``comparison.json``

In: a design. Out: a :class:`Comparison`.
"""

from metafab.comparison.rivals import Rival, rivals
from metafab.comparison.study import (
    Comparison,
    ComparisonFigures,
    compare,
    comparison_figures,
    load_comparison,
    save_comparison,
)

__all__ = [
    "Comparison",
    "ComparisonFigures",
    "Rival",
    "compare",
    "comparison_figures",
    "load_comparison",
    "rivals",
    "save_comparison",
]
