"""Pictures on many steps of depth, which no few layers explain: their depths, and no sureness where they are wrong."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from metafab.camera import RawFrame, capture
from metafab.decode import decode
from metafab.decode.evaluation import overlap
from metafab.optics.point_spread import Psf
from metafab.spec import Scene
from metafab.spec.scene import Rgbd
from tests.conjugate_pair import helix_psf

NEAR_M, FAR_M, STEPS, SHAPE = 0.00252, 0.00345, 4, (300, 165)


def photographed(psf: Psf, seed: int) -> RawFrame:
    """A 1/k texture of which each quarter, by the light about a pixel, has a depth of its own."""
    rng, (n_y, n_x) = np.random.default_rng(seed), SHAPE
    k = np.hypot(*np.meshgrid(np.fft.fftfreq(n_y), np.fft.fftfreq(n_x), indexing="ij"))
    light = np.fft.ifft2(np.fft.fft2(rng.normal(size=SHAPE)) / np.maximum(k, 1.0 / n_y)).real
    light /= light.std()
    slow = gaussian_filter(light, 6.0, mode="wrap")
    step = np.digitize(slow, np.quantile(slow, np.arange(1, STEPS) / STEPS)) / (STEPS - 1.0)
    with TemporaryDirectory() as name:
        folder = Path(name)
        np.save(folder / "light.npy", np.exp(0.5 * light))
        np.save(folder / "depth.npy", 1.0 / (1.0 / FAR_M + (1.0 / NEAR_M - 1.0 / FAR_M) * step))
        picture = Rgbd(image_file=folder / "light.npy", depth_file=folder / "depth.npy")
        return capture(Scene(rgbd=picture, field_px=SHAPE, photons_per_pixel=3000.0), psf)


@pytest.mark.parametrize("seed", [1, 2])
def test_steps_that_layers_do_not_explain_are_decoded_as_surfaces_and_doubted(seed: int) -> None:
    """By layers, whose interiors hold light of other depths, 47 and 28 % of the sure pixels were wrong."""
    psf = helix_psf(1.0 / np.linspace(1 / 0.00238, 1 / 0.0037, 11))
    frame = photographed(psf, seed)
    image = decode(frame, psf)
    both = overlap(image, frame)
    assert both is not None
    here, truth = both
    error = np.abs(image.depth_m[here] / truth.depth_m - 1.0)
    sure = (image.confidence[here] > 0.9) & np.isfinite(error)
    # Measured: 1.0 and 0.7 % of 20 and 31 % of the pixels are wrong, the mean error is 2.8 and 2.2 %.
    assert sure.mean() > 0.1 and (error[sure] > 0.05).mean() < 0.02
    assert np.nanmean(error) < 0.04 and np.isfinite(error).mean() > 0.6
