"""Comparison of a design's camera with others of equal aperture, light and sensor: depth and sharpness over depth.

- ``study``  the cameras (the design, its lens without a helix, a double helix) and their PSFs, photographs of planes by
  all of them, the errors of their depth estimates, ``comparison.json``

In: a design. Out: a :class:`Comparison`.
"""

from metafab.comparison.study import (
    Comparison,
    ComparisonFigures,
    Rival,
    compare,
    comparison_figures,
    load_comparison,
    rivals,
    save_comparison,
)

__all__ = [
    "compare",
    "Comparison",
    "ComparisonFigures",
    "comparison_figures",
    "rivals",
    "Rival",
    "load_comparison",
    "save_comparison",
]
