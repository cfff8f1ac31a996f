"""Figures of a mask against the nominal one: peaks, efficiency, extinction, turn, focus and decoded depth.

The depth error is that of a decoder calibrated on the nominal mask. It filters the image of each polarisation by the
other's PSF at a trial depth, and takes the depth of the largest correlation of the two.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.figures import ToleranceRow
from metafab.core.numeric.interpolation import parabolic_maximum, spline_weights
from metafab.decode.matching.cost_volume import correlation
from metafab.optics.geometry.imaging import depth_nodes
from metafab.optics.measures.metrics import main_lobe_px, orientation_deg
from metafab.optics.propagation.image import relative_l2
from metafab.optics.propagation.pupil import Pupil
from metafab.tolerance.mask_light import Light, MaskOptics

#: Trial depths of the decoder: their margin beyond the table's depths, as a share of the range of vergence, and at
#: least of the nearest depth's vergence, for tables of one depth; and their number per depth of the calibration.
_MARGIN, _LEAST_MARGIN, _TRIALS = 0.25, 0.02, 6
#: Least vergence of the trial depths, as a share of the farthest depth's, if that is finite: the margin of a wide range
#: reaches beyond infinity.
_LEAST_VERGENCE = 1e-3
#: Relative L2 error of the calibration, interpolated over depth.
_CALIBRATION_ERROR = 1e-3
#: Over draws, figures with a systematic shift are averaged; the others have both signs and are given as rms.
_MEAN_OVER_DRAWS = (
    "peak_ratio",
    "efficiency",
    "efficiency_change",
    "extinction_ratio",
    "fwhm_x_um",
    "fwhm_y_um",
    "strehl",
)
_RMS_OVER_DRAWS = ("change", "turn_deg", "depth_error_m")
#: Shortest distance of a main lobe from the image point, in wavelengths / NA: half of Airy's width at half maximum.
_ARM = 0.25


@dataclass(frozen=True)
class DepthDecoder:
    """Depth from the twin images of a point, by the calibration of the nominal mask."""

    trial_m: FloatArray  #: Shape (n_trial,), trial depths, evenly spaced in vergence.
    transfer: ComplexArray  #: Shape (2, n_trial, n, m), half spectra of the nominal pair at the trial depths.

    @classmethod
    def of(cls, optics: MaskOptics, pupils: Sequence[Pupil]) -> DepthDecoder:
        """Calibrate on the blocks of the nominal mask."""
        depths_m = optics.conditions.depths_m
        near, far = 1.0 / depths_m[0], 1.0 / depths_m[-1]
        margin = max(_MARGIN * (near - far), _LEAST_MARGIN * near)
        farthest_m = 1.0 / max(far - margin, _LEAST_VERGENCE * far) if far > 0.0 else math.inf
        nodes = depth_nodes(optics.window.imaging, 1.0 / (near + margin), farthest_m, _CALIBRATION_ERROR)
        at_nodes = replace(optics.conditions, depths_m=tuple(nodes.tolist()), lens=None)
        stack = replace(optics, conditions=at_nodes).light(pupils).pair
        vergence = np.linspace(1.0 / nodes[0], 1.0 / nodes[-1], _TRIALS * nodes.size)
        weights = spline_weights(1.0 / nodes, vergence)
        with np.errstate(divide="ignore"):
            trial_m = 1.0 / vergence
        return cls(trial_m, np.einsum("td,pdij->ptij", weights, np.fft.rfft2(stack), optimize=True))

    def depth_m(self, pair: FloatArray) -> FloatArray:
        """Return the depths of points from their images, shape (2, n_depth, n, n).

        Shape (n_depth,); NaN where the correlation is largest at an end of the trial depths.
        """
        vergence = 1.0 / self.trial_m
        depths = []
        for one, other in zip(*np.fft.rfft2(pair), strict=True):
            filtered, twin = one * self.transfer[1], other * self.transfer[0]
            parts = np.array([_inner(filtered, twin), _inner(filtered, filtered), _inner(twin, twin)])
            place = parabolic_maximum(correlation(parts))
            depths.append(1.0 / (vergence[0] + place * (vergence[1] - vergence[0])))
        return np.array(depths)


def _inner(a: ComplexArray, b: ComplexArray) -> FloatArray:
    """Inner product of half spectra over their last two axes; columns but the first count twice."""
    weight = np.full(a.shape[-1], 2.0)
    weight[0] = 1.0
    return np.asarray(((a.real * b.real + a.imag * b.imag) @ weight).sum(axis=-1))


@dataclass(frozen=True)
class Reference:
    """Light and decoded depths of the nominal mask, with which other masks are compared."""

    nominal: Light  #: Light at the depths of the table.
    depths_m: tuple[float, ...]  #: Depths of the table.
    decoder: DepthDecoder | None  #: Decoder calibrated on the nominal mask; None where one window holds both images.
    decoded_m: FloatArray  #: Shape (n_depth,), decoded depths of the nominal mask itself; NaN without a decoder.
    error: float  #: Relative L2 error of any PSF.
    smallest_arm_um: float = 0.0  #: A main lobe nearer to the image point than this has no direction.
    ideal_peak: float = math.nan  #: See :attr:`MaskOptics.ideal_peak`.

    @classmethod
    def of(cls, optics: MaskOptics, pupils: Sequence[Pupil], error: float) -> Reference:
        """Compute the reference from the blocks of the nominal mask."""
        nominal = optics.light(pupils)
        decoder = DepthDecoder.of(optics, pupils) if optics.is_pair else None
        depths_m = optics.conditions.depths_m
        decoded_m = np.full(len(depths_m), math.nan) if decoder is None else decoder.depth_m(nominal.pair)
        imaging = optics.window.imaging
        arm_um = _ARM * imaging.wavelength_um / imaging.numerical_aperture
        return cls(nominal, depths_m, decoder, decoded_m, error, arm_um, optics.ideal_peak)

    def row(self, name: str, lights: Sequence[Light], relative_error: float) -> ToleranceRow:
        """Return the row of one mask, or of several draws of a random fault (rms or mean over the draws)."""
        rows = [self._row(name, light, relative_error) for light in lights]
        if len(rows) == 1:
            return rows[0]
        mean = {key: float(np.mean([getattr(row, key) for row in rows])) for key in _MEAN_OVER_DRAWS}
        rms = {key: float(np.sqrt(np.mean([getattr(row, key) ** 2 for row in rows]))) for key in _RMS_OVER_DRAWS}
        return replace(rows[0], **mean, **rms, below_error=rms["change"] <= self.error)  # type: ignore[arg-type]

    def _row(self, name: str, light: Light, relative_error: float) -> ToleranceRow:
        before, after = self.nominal, light
        n_depth, finite = len(self.depths_m), np.isfinite(self.depths_m)
        depth_error_m = self.decoded_m if self.decoder is None else self.decoder.depth_m(after.pair) - self.decoded_m
        arms_um = [math.hypot(*main_lobe_px(image)[:2]) * before.pixel_um for image in before.pair[0]]
        turn = (orientation_deg(after.pair[0]) - orientation_deg(before.pair[0]) + 180.0) % 360.0 - 180.0
        change = max(relative_l2(after.pair[p, d], before.pair[p, d]) for p in (0, 1) for d in range(n_depth))
        return ToleranceRow(
            name,
            change,
            peak_ratio=float((_peaks(after.pair) / _peaks(before.pair)).min()),
            efficiency=float(after.efficiency.min()),
            efficiency_change=_largest(after.efficiency - before.efficiency),
            extinction_ratio=float(after.extinction.min()),
            turn_deg=_largest(np.where(np.array(arms_um) >= self.smallest_arm_um, turn, math.nan)),
            depth_error_m=_largest(depth_error_m[finite]) if finite.any() else math.nan,
            relative_error=relative_error,
            below_error=change <= self.error,
            fwhm_x_um=after.spot[0],
            fwhm_y_um=after.spot[1],
            strehl=after.spot[2] / self.ideal_peak,
        )


def _peaks(pair: FloatArray) -> FloatArray:
    return np.array([[main_lobe_px(image)[2] for image in stack] for stack in pair])


def _largest(values: FloatArray) -> float:
    """The signed value of the largest modulus; NaN if any is."""
    flat = np.asarray(values).ravel()
    return float("nan") if np.isnan(flat).any() else float(flat[int(np.argmax(np.abs(flat)))])
