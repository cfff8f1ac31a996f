"""A design's camera beside others of equal aperture, light and sensor: depth and sharpness over depth.

- ``rivals``    the design, the same lens without its helix, and with a double helix: their PSFs
- ``estimate``  depth of a textured plane from its images: maximum likelihood, cepstrum; the bound of both
- ``study``     photographs of planes over depth by all cameras, and what is found in them; comparison.json

In: a design. Out: a Comparison.
"""

from metafab.comparison.rivals import Rival, rivals
from metafab.comparison.study import Comparison, compare, comparison_figures, load_comparison, save_comparison

__all__ = ["Comparison", "Rival", "compare", "comparison_figures", "load_comparison", "rivals", "save_comparison"]
