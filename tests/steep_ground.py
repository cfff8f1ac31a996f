"""A picture with its depth: ground that leads away steeply, and a disc before its far part, of 1/k texture."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from metafab.camera import RawFrame, capture
from metafab.core.conventions import FloatArray
from metafab.decode import Decoder
from metafab.decode.evaluation import overlap
from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.matching.depth import PixelDepth
from metafab.decode.segmentation.prepared_frame import PreparedFrame
from metafab.decode.segmentation.regions import textured_pixel_depth
from metafab.spec import Scene
from metafab.spec.scene import Rgbd
from tests.conjugate_pair import helix_psf

NEAR_M, FAR_M = 0.00252, 0.00345
SHAPE = (160, 160)
Matched = tuple[PreparedFrame, CostVolume, PixelDepth]


@cache
def photographed(disc_light: float = 1.0) -> tuple[Decoder, RawFrame]:
    """The ground, from the nearest to the farthest depth in 160 rows, and a disc of some times its light."""
    rng, (n_y, n_x) = np.random.default_rng(3), SHAPE
    k = np.hypot(*np.meshgrid(np.fft.fftfreq(n_y), np.fft.fftfreq(n_x), indexing="ij"))
    noise = np.fft.ifft2(np.fft.fft2(rng.normal(size=SHAPE)) / np.maximum(k, 1.0 / n_y)).real
    row, column = np.mgrid[:n_y, :n_x]
    vergence = 1.0 / FAR_M + (1.0 / NEAR_M - 1.0 / FAR_M) * row / (n_y - 1.0)  # the first row is the top one
    disc = np.hypot(row - 45.0, column - 80.0) < 30.0
    psf = helix_psf(1.0 / np.linspace(1 / 0.00238, 1 / 0.0037, 11))
    with TemporaryDirectory() as name:
        folder = Path(name)
        np.save(folder / "light.npy", np.exp(0.3 * noise / noise.std()) * np.where(disc, disc_light, 1.0))
        np.save(folder / "depth.npy", np.where(disc, 0.0026, 1.0 / vergence))
        picture = Rgbd(image_file=folder / "light.npy", depth_file=folder / "depth.npy")
        frame = capture(Scene(rgbd=picture, field_px=SHAPE, photons_per_pixel=3000.0), psf)
    decoder = Decoder.of(psf, frame.frame.shape, frame.origin_um, frame.x_window)
    assert decoder is not None
    return decoder, frame


def matched(decoder: Decoder, frame: RawFrame) -> Matched:
    """The frame prepared, its cost volume and the depth of each pixel."""
    prepared = decoder.prepare(frame)
    assert not isinstance(prepared, str)
    volume = decoder.match(prepared).volume
    return prepared, volume, textured_pixel_depth(prepared, volume)


def errors(decoder: Decoder, frame: RawFrame, depth_m: FloatArray) -> FloatArray:
    """Relative errors of a depth map on downsampled pixels, where the truth is known."""
    both, step = overlap(decoder(frame), frame), decoder.filters.downsampling.step
    assert both is not None
    here, truth = both
    true_m = np.full(decoder.calibration.grid.shape, np.nan)
    true_m[here] = truth.depth_m
    error = np.abs(depth_m / true_m[::step, ::step][: depth_m.shape[0], : depth_m.shape[1]] - 1.0)
    return np.asarray(error[np.isfinite(error)])
