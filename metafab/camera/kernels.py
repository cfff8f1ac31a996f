"""Blur kernels of the calibrated PSF pair, at any depth and direction of the field.

Between the calibrated points the pair is interpolated by cubic splines: over depth in vergence (1/z), in which the
helix turns at a constant rate, and over the field in tangents. Nothing is extrapolated over depth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.numeric.interpolation import spline_weights
from metafab.optics.point_spread import Psf


@dataclass(frozen=True)
class PairKernels:
    """Kernels of a PSF calibration, integrated over the pixel.

    Their sums are throughputs relative to the mean of both polarisations on the axis at the middle depth.
    """

    psf: Psf  #: The calibration.
    relative_to: Psf | None = None  #: Pair whose throughput is 1; ``psf`` itself by default.

    @classmethod
    def of_unpolarised(cls, psf: Psf) -> PairKernels:
        """Kernels of each image for unpolarised light: those of a calibration plus its ghosts."""
        if psf.ghost is None:
            return cls(psf)
        field, ghost_field = psf.field, psf.ghost.field
        if field is not None and ghost_field is not None:
            field = replace(field, psf=field.psf + ghost_field.psf)
        return cls(replace(psf, psf=psf.psf + psf.ghost.psf, field=field, ghost=None), psf)

    @property
    def mean_throughput(self) -> float:
        """Mean of both polarisations on the axis at the middle depth: 1 for a pair relative to itself."""
        return _mean_sum(self.psf) / _mean_sum(self.relative_to or self.psf)

    @cached_property
    def tangent_x(self) -> FloatArray:
        """x/z of the field points, shape (n_field_x,); one point on the axis without a field."""
        return np.zeros(1) if self.psf.field is None else self.psf.field.tangent_x

    @cached_property
    def tangent_y(self) -> FloatArray:
        """y/z of the field points, shape (n_field_y,)."""
        return np.zeros(1) if self.psf.field is None else self.psf.field.tangent_y

    @cached_property
    def nodes(self) -> NDArray[np.float32]:
        """Kernels at all calibrated points: shape (2, n_depth, n_field_y, n_field_x, n_y, n_x)."""
        psf = self.psf
        middle = psf.depth_m.size // 2
        if psf.field is None:
            nodes, centre = np.asarray(psf.psf)[:, :, None, None], psf.centre_um[:, :, None, None]
        else:
            nodes, centre = np.asarray(psf.field.psf), psf.field.centre_um
        # Kernels are centred on the geometric image point of the middle depth, whatever the place of their windows.
        offset_px = (centre - centre[:, middle : middle + 1]) / psf.pixel_um
        n_y, n_x = nodes.shape[-2:]
        ky, kx = scipy.fft.fftfreq(n_y)[:, None], scipy.fft.rfftfreq(n_x)[None, :]
        pixel, is_centred = pixel_transfer((n_y, n_x)), np.abs(offset_px).max() <= 1e-6
        kernels, unit = np.empty(nodes.shape, dtype=np.float32), _mean_sum(self.relative_to or psf)
        for place in np.ndindex(nodes.shape[:2]):  # one depth at a time, for its memory
            transfer = scipy.fft.rfft2(nodes[place].astype(np.float64)) * pixel
            if not is_centred:
                offset = offset_px[place][..., None, None, :]
                transfer *= np.exp(-2j * np.pi * (ky * offset[..., 1] + kx * offset[..., 0]))
            kernels[place] = scipy.fft.irfft2(transfer, (n_y, n_x)) / unit
        return kernels

    @property
    def shape(self) -> tuple[int, int]:
        """(n_y, n_x) of a kernel; its origin is ``[n_y // 2, n_x // 2]``."""
        return self.psf.psf.shape[-2], self.psf.psf.shape[-1]

    def at_depth(self, depth_m: float) -> FloatArray:
        """Kernels at the field points for one depth: shape (2, n_field_y, n_field_x, n_y, n_x).

        A depth outside the calibrated range raises InputError.
        """
        nearest, farthest = self.psf.depth_m.min(), self.psf.depth_m.max()
        slack = 1e-9 * farthest
        if not nearest - slack <= depth_m <= farthest + slack:
            expected = f"a depth inside the PSF calibration, {nearest:g} to {farthest:g} m"
            remedy = (
                "calibrate the PSF over a wider range of depths (`metafab psf --depths-m ...`); the depths of an "
                "object hold its tilt, bulge and motion"
            )
            raise InputError.single("scene", "depth_m", expected, f"{depth_m:g} m", remedy)
        weights = spline_weights(1.0 / self.psf.depth_m, 1.0 / depth_m)
        return np.stack([np.tensordot(weights, one, axes=1) for one in self.nodes])

    def field_weights(self, tangent_x: FloatArray, tangent_y: FloatArray) -> FloatArray:
        """Interpolation weights of the field points at directions of any shape: (*that shape, n_field_y, n_field_x)."""
        along_y, along_x = spline_weights(self.tangent_y, tangent_y), spline_weights(self.tangent_x, tangent_x)
        return along_y[..., :, None] * along_x[..., None, :]


def _mean_sum(psf: Psf) -> float:
    """Sum of the irradiance at the middle depth, mean of both polarisations."""
    return float(psf.psf[:, psf.depth_m.size // 2].sum(axis=(-2, -1)).mean())


def pixel_transfer(shape: tuple[int, int]) -> FloatArray:
    """Return the transfer function of a square pixel for a real transform, shape (n_y, n_x // 2 + 1)."""
    return np.asarray(np.sinc(scipy.fft.fftfreq(shape[0]))[:, None] * np.sinc(scipy.fft.rfftfreq(shape[1])))
