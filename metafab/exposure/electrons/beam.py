"""Point-spread function of the electron beam in the resist, as a sum of Gaussians.

Every supported function is a mixture of Gaussians, whose dose on a rectangle is a product of error functions:

- ``gauss``  exp(-r^2 / range^2) / (pi range^2);
- ``power``  (1 + r^2 / range^2)^(-exponent / 2), normalised: the power law that measurements at high voltage show
  between the forward-scattered beam and the backscattered electrons (Hougs et al., arXiv 2506.21236, 2025). With
  s = range^2 / beta^2 it is the integral of s^(exponent / 2 - 1) exp(-s) exp(-r^2 / beta^2) over s, and the trapezoidal
  rule in log s converges exponentially;
- a table of radial energy density (CASINO, or :mod:`metafab.exposure.electrons.monte_carlo`), fitted by least squares.
  Backscattered electrons have a range: their density ends more steeply than any sum of Gaussians of positive weights,
  so that those of :data:`BACKSCATTER_NM` and more may have negative ones.

A weight is the share of the deposited energy; weights add up to 1. The energy of a large pad at dose 1 is 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls
from scipy.special import gammaln

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.spec.mask import BeamTerm

#: Least range of backscattered electrons (nm).
BACKSCATTER_NM = 2000.0
#: Step of log s in the mixture of a power law: the ripple of the density is below 1e-4 of itself.
_LOG_STEP = 0.7
#: Largest range of a Gaussian in a power law (nm): the range of 100 keV electrons in silicon, which ends the law.
_LARGEST_RANGE_NM = 5e4
#: Largest negative share of all energy that terms may have in any ring of a factor e in radius: three times that of
#: the presets' fits beyond the range of the electrons.
_MOST_NEGATIVE = 0.01
#: Ratio of neighbouring ranges in the fit of a table, and the share of all energy below which a ring counts less.
_FIT_RATIO, _FIT_FLOOR = 1.35, 1e-4
#: Empty rings beyond the table, and least ratio of their radii: they reach to three times its last radius, which
#: no fitted range exceeds by more than :data:`_FIT_RATIO`.
_EMPTY_RINGS, _EMPTY_RATIO = 4, 4.0 / 3.0
#: Weight in the fit of the energy within each radius, relative to that of a ring's relative error.
_FIT_WITHIN = 30.0
#: Likewise of the sum of all weights.
_FIT_SUM = 1e3
#: Likewise of a penalty on large weights: those of opposite signs magnify the errors of the energy, the more the
#: shorter their ranges are.
_FIT_SMALL = 0.3
#: Least share of all energy of the rings whose relative errors are stated; of a finer table those with at least half
#: of its largest ring's.
_STATED_SHARE = 1e-3


@dataclass(frozen=True)
class BeamPsf:
    """Point-spread function of the beam in the resist."""

    weight: FloatArray  #: Shape (n,), shares of the deposited energy; they add up to 1.
    range_nm: FloatArray  #: Shape (n,), ranges beta of the Gaussians exp(-r^2 / beta^2), ascending.
    terms: tuple[BeamTerm, ...]  #: Terms that the Gaussians represent; empty for a fitted table.
    source: str  #: Reference of the numbers, or "assumption".
    #: Largest difference between the fitted and the tabulated share of energy within any radius; 0 without a table.
    fit_error: float = 0.0
    #: Least and largest fitted over tabulated energy of rings with at least 1e-3 of all energy (of a finer table, with
    #: at least half of its largest ring's); 1 without a table.
    fit_ratio: tuple[float, float] = (1.0, 1.0)
    blur_nm: float = 0.0  #: Range of the Gaussian that ``terms`` or the table are convolved with in ``range_nm``.

    @classmethod
    def of(cls, terms: Sequence[BeamTerm], source: str) -> BeamPsf:
        """Expand terms into Gaussians; weights are normalised to a sum of 1.

        InputError for no term, weights without a positive sum, or a density that negative weights make negative.
        """
        if not terms:
            raise InputError.single("exposure", "terms", "at least one term", "none")
        total = sum(term.weight for term in terms)
        if total <= 0.0:
            raise InputError.single("exposure", "terms", "weights of a positive sum", f"a sum of {total:g}")
        weights, ranges = [], []
        for term in terms:
            part_weight, part_range = _gaussians(term)
            weights.append(part_weight * term.weight / total)
            ranges.append(part_range)
        weight, range_nm = np.concatenate(weights), np.concatenate(ranges)
        order = np.argsort(range_nm)
        psf = cls(weight[order], range_nm[order], tuple(terms), source)
        radius_nm = np.geomspace(0.1 * range_nm.min(), 4.0 * range_nm.max(), 1000)
        energy = 2.0 * math.pi * radius_nm**2 * psf.density(radius_nm)
        if energy.min() < -_MOST_NEGATIVE:
            expected, worst = "an energy density that is nowhere negative", radius_nm[energy.argmin()]
            got = f"{energy.min():.2g} of all energy for a factor of e in radius, at {worst:.3g} nm"
            raise InputError.single("exposure", "terms", expected, got, "weaken the terms of negative weight")
        return psf

    @classmethod
    def fitted(cls, radius_nm: FloatArray, density: FloatArray, source: str) -> BeamPsf:
        """Fit Gaussians to a radial table of energy per area, any unit, at ascending positive radii: shape (n,) each.

        No energy lies beyond the last radius. ``source`` is its reference. InputError for fewer than eight rows, or
        values out of range.
        """
        sound = (
            radius_nm.size >= 8 and radius_nm[0] > 0.0 and np.all(np.diff(radius_nm) > 0.0) and np.all(density >= 0.0)
        )
        if not sound or not np.any(density > 0.0):
            expected = "at least 8 rows of ascending radius and energy density >= 0"
            raise InputError.single("exposure", "table", expected, f"{radius_nm.size} rows")
        smallest = 0.25 * radius_nm[0]  # energy within the first radius may lie on the axis
        count = math.ceil(math.log(radius_nm[-1] / smallest) / math.log(_FIT_RATIO)) + 1
        ranges = smallest * _FIT_RATIO ** np.arange(count)
        # Energies of rings whose edges lie halfway between radii on a logarithmic scale, the first a disc.
        edges = np.concatenate(
            [[0.0], np.sqrt(radius_nm[1:] * radius_nm[:-1]), [radius_nm[-1] ** 1.5 / radius_nm[-2] ** 0.5]]
        )
        ring = np.append(density * math.pi * np.diff(edges**2), np.zeros(_EMPTY_RINGS))
        ring /= ring.sum()
        ratio = max(edges[-1] / edges[-2], _EMPTY_RATIO)
        edges = np.append(edges, edges[-1] * ratio ** np.arange(1, _EMPTY_RINGS + 1))
        gaussians = -np.diff(np.exp(-((edges[:, None] / ranges) ** 2)), axis=0)
        scale = 1.0 / np.maximum(ring, _FIT_FLOOR)
        signed = ranges >= BACKSCATTER_NM
        rows = [gaussians * scale[:, None], _FIT_WITHIN * np.cumsum(gaussians, axis=0), np.full((1, count), _FIT_SUM)]
        matrix = np.concatenate(rows)
        matrix = np.concatenate([matrix, -matrix[:, signed]], axis=1)
        small = _FIT_SMALL * np.where(signed, np.maximum(1.0, radius_nm[-1] / ranges), 1.0)
        matrix = np.concatenate([matrix, np.diag(np.append(small, small[signed]))])
        wanted = np.concatenate([ring * scale, _FIT_WITHIN * np.cumsum(ring), [_FIT_SUM], np.zeros(matrix.shape[1])])
        parts, _ = nnls(matrix, wanted, maxiter=100 * matrix.shape[1])
        weight = parts[:count]
        weight[signed] -= parts[count:]
        weight /= weight.sum()
        fitted, used, stated = gaussians @ weight, weight != 0.0, ring >= min(_STATED_SHARE, 0.5 * ring.max())
        over = fitted[stated] / ring[stated]
        within = float(np.abs(np.cumsum(fitted - ring)).max())
        return cls(weight[used], ranges[used], (), source, within, (float(over.min()), float(over.max())))

    def density(self, radius_nm: FloatArray) -> FloatArray:
        """Energy density per nm^2 at ``radius_nm``, in its shape."""
        square = np.asarray(radius_nm, dtype=np.float64)[..., None] ** 2 / self.range_nm**2
        return np.asarray((np.exp(-square) * (self.weight / (math.pi * self.range_nm**2))).sum(axis=-1))

    def blurred(self, range_nm: float) -> BeamPsf:
        """The function convolved with a Gaussian of range ``range_nm``."""
        ranges = np.hypot(self.range_nm, range_nm)
        return replace(self, range_nm=ranges, blur_nm=math.hypot(self.blur_nm, range_nm))

    def scattered(self) -> tuple[BeamPsf, BeamPsf, float]:
        """Split into the forward and the backscattered part, each of weight 1, and their ratio eta.

        InputError if there is no backscattered, or no forward, part.
        """
        parts = self.between(0.0, BACKSCATTER_NM), self.between(BACKSCATTER_NM, math.inf)
        forward, back = (float(part.weight.sum()) for part in parts)
        if not forward or not back:
            expected = f"ranges below and above {BACKSCATTER_NM:g} nm, forward-scattered and backscattered electrons"
            got = f"{self.range_nm.min():g} to {self.range_nm.max():g} nm"
            raise InputError.single("exposure", "backscatter_ratio", expected, got, "add a term")
        split = [replace(part, weight=part.weight / part.weight.sum()) for part in parts]
        return split[0], split[1], back / forward

    def with_backscatter(self, ratio: float) -> BeamPsf:
        """The function with the ratio of its backscattered to its forward-scattered energy changed to ``ratio``."""
        forward, back, _ = self.scattered()
        weight = np.concatenate([forward.weight, ratio * back.weight]) / (1.0 + ratio)
        return replace(self, weight=weight)

    def between(self, low_nm: float, high_nm: float) -> BeamPsf:
        """The Gaussians with ``low_nm`` <= range < ``high_nm``; their weights are kept, not normalised."""
        part = (self.range_nm >= low_nm) & (self.range_nm < high_nm)
        return replace(self, weight=self.weight[part], range_nm=self.range_nm[part])


def _gaussians(term: BeamTerm) -> tuple[FloatArray, FloatArray]:
    """Weights and ranges of the mixture of one term of weight 1."""
    if term.exponent is None:
        return np.ones(1), np.array([term.range_nm])
    half = 0.5 * term.exponent
    lowest = 2.0 * math.log(term.range_nm / _LARGEST_RANGE_NM)
    log_s = np.arange(min(lowest, -2.0), 5.0, _LOG_STEP)
    weight = np.exp(log_s * (half - 1.0) - np.exp(log_s) - gammaln(half - 1.0)) * _LOG_STEP
    used = weight > 1e-7
    return weight[used] / weight[used].sum(), term.range_nm * np.exp(-0.5 * log_s[used])
