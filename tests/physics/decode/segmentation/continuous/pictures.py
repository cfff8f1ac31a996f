"""Pictures with their depth for tests of continuous surfaces: their texture, photograph and judgement."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from metafab.camera import RawFrame, capture
from metafab.core.conventions import FloatArray
from metafab.decode import decode
from metafab.decode.evaluation import overlap
from metafab.optics.point_spread import Psf
from metafab.spec import Scene
from metafab.spec.scene import Rgbd
from tests.conjugate_pair import helix_psf

SHAPE = (300, 165)


def calibration() -> Psf:
    """A rotating pair over the depths of the pictures."""
    return helix_psf(1.0 / np.linspace(1 / 0.00238, 1 / 0.0037, 11))


def texture(rng: np.random.Generator) -> FloatArray:
    """A 1/k texture of rms 1, shape ``SHAPE``."""
    n_y, n_x = SHAPE
    k = np.hypot(*np.meshgrid(np.fft.fftfreq(n_y), np.fft.fftfreq(n_x), indexing="ij"))
    light = np.fft.ifft2(np.fft.fft2(rng.normal(size=SHAPE)) / np.maximum(k, 1.0 / n_y)).real
    return np.asarray(light / light.std())


def photographed(light: FloatArray, depth_m: FloatArray, psf: Psf, electrons: float = 3000.0) -> RawFrame:
    """Frame of a picture and its depth, arrays of one shape, at so many electrons a pixel."""
    with TemporaryDirectory() as name:
        files = Path(name) / "light.npy", Path(name) / "depth.npy"
        for file, values in zip(files, (light, depth_m), strict=True):
            np.save(file, values)
        picture = Rgbd(image_file=files[0], depth_file=files[1])
        return capture(Scene(rgbd=picture, field_px=light.shape, photons_per_pixel=electrons), psf)


def judged(frame: RawFrame, psf: Psf) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Relative error of the decoded depth, NaN for none, and the pixels of a confidence above 0.9."""
    image = decode(frame, psf)
    both = overlap(image, frame)
    assert both is not None
    here, truth = both
    error = np.abs(image.depth_m[here] / truth.depth_m - 1.0)
    return error, (image.confidence[here] > 0.9) & np.isfinite(error)
