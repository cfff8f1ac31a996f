"""Plain dim ground about textured objects: the twins agree in the blur of outlines, far beyond these."""

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

SHAPE = (300, 165)


def photographed(psf: Psf, seed: int) -> RawFrame:
    """Textured hills of a third of the picture before a ground without texture of a third of their light."""
    rng, (n_y, n_x) = np.random.default_rng(seed), SHAPE
    k = np.hypot(*np.meshgrid(np.fft.fftfreq(n_y), np.fft.fftfreq(n_x), indexing="ij"))
    texture = np.fft.ifft2(np.fft.fft2(rng.normal(size=SHAPE)) / np.maximum(k, 1.0 / n_y)).real
    hills, slow = (gaussian_filter(rng.normal(size=SHAPE), px, mode="wrap") for px in (14.0, 50.0))
    near, rise = hills > np.quantile(hills, 2.0 / 3.0), slow / np.abs(slow).max()
    with TemporaryDirectory() as name:
        folder = Path(name)
        np.save(folder / "light.npy", np.where(near, np.exp(0.5 * texture / texture.std()), 0.35))
        np.save(folder / "depth.npy", 1.0 / np.where(near, 375.0 + 15.0 * rise, 315.0 + 20.0 * rise))
        picture = Rgbd(image_file=folder / "light.npy", depth_file=folder / "depth.npy")
        return capture(Scene(rgbd=picture, field_px=SHAPE, photons_per_pixel=3000.0), psf)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_ground_that_shows_the_blur_of_outlines_alone_is_not_sure(seed: int) -> None:
    psf = helix_psf(1.0 / np.linspace(1 / 0.00238, 1 / 0.0037, 11))
    frame = photographed(psf, seed)
    image = decode(frame, psf)
    both = overlap(image, frame)
    assert both is not None
    here, truth = both
    error = np.abs(image.depth_m[here] / truth.depth_m - 1.0)
    sure = (image.confidence[here] > 0.9) & np.isfinite(error)
    # Measured: of 21, 17 and 15 % of the pixels 3.9, 1.2 and 2.9 % are wrong. While no measure told the blur of an
    # outline from texture, it was 56, 48 and 63 % of 71, 62 and 78 %.
    assert sure.mean() > 0.1 and (error[sure] > 0.05).mean() < 0.06
