"""The doubt of a calibration: small pictures of steep and stepped surfaces raise none, wrong calibrations do."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from metafab.camera import RawFrame, capture
from metafab.core.conventions import FloatArray
from metafab.decode import decode
from metafab.optics.point_spread import Psf
from metafab.spec import Scene
from metafab.spec.scene import Rgbd
from tests.conjugate_pair import helix_psf

NEAR, FAR = 1.0 / 0.00245, 1.0 / 0.00359


def calibration() -> Psf:
    return helix_psf(1.0 / np.linspace(1 / 0.00238, 1 / 0.0037, 11))


def vergence_per_m(surface: str, side: int) -> FloatArray:
    """1/depth of a surface over the whole calibrated range, top row first."""
    row, column = np.mgrid[:side, :side] / side
    if surface == "wave":
        return np.asarray(0.5 * (NEAR + FAR) + 0.4 * (NEAR - FAR) * np.sin(5 * row) * np.cos(4 * column))
    ground = FAR + (NEAR - FAR) * row
    disc = np.hypot(row - 0.5, column - 0.5) < 0.2
    return np.where(disc & (surface == "disc"), NEAR / 1.1, ground)


@cache
def photographed(surface: str, side: int, seed: int = 1, haze_e: float = 0.0) -> RawFrame:
    """A picture of 1/k texture on the surface; haze lies on the whole sensor, whose field stop is then not known."""
    rng = np.random.default_rng(seed)
    k = np.hypot(*np.meshgrid(np.fft.fftfreq(side), np.fft.fftfreq(side), indexing="ij"))
    noise = np.fft.ifft2(np.fft.fft2(rng.normal(size=k.shape)) / np.maximum(k, 1.0 / side)).real
    with TemporaryDirectory() as name:
        files = Path(name) / "light.npy", Path(name) / "depth.npy"
        for file, values in zip(
            files, (np.exp(0.3 * noise / noise.std()), 1.0 / vergence_per_m(surface, side)), strict=True
        ):
            np.save(file, values)
        frame = capture(Scene(rgbd=Rgbd(*files), field_px=k.shape, seed=seed), calibration())
    if haze_e == 0.0:
        return frame
    return replace(frame, frame=frame.frame + rng.poisson(haze_e, frame.frame.shape), x_window=None)


#: Frames whose segments as a whole may be up to 10 % unlike behind the right calibration. Of the smallest disc in haze,
#: two of eight draws are doubted, and of the smallest wave one, on machines with some kernels of BLAS alone.
FRAMES = [("disc", 100, 1, 0.0), ("disc", 100, 2, 0.0), ("wave", 100, 1, 0.0), ("ground", 128, 1, 0.0)]
HAZY = [("ground", 64, 2, 800.0), ("wave", 64, 3, 800.0), ("disc", 64, 2, 800.0), ("ground", 100, 1, 800.0)]


@pytest.mark.parametrize("which", [*FRAMES, *HAZY])
def test_small_pictures_of_steep_surfaces_do_not_doubt_their_own_calibration(
    which: tuple[str, int, int, float],
) -> None:
    assert decode(photographed(*which), calibration()).figures.warning is None


@pytest.mark.parametrize("which", [*FRAMES, ("ground", 100, 1, 800.0)])
@pytest.mark.parametrize("wrong", ["exchanged", "turned", "a sensor rotated by 1 degree", "images 3 % too large"])
def test_the_same_pictures_doubt_a_wrong_calibration(which: tuple[str, int, int, float], wrong: str) -> None:
    right = calibration()
    angle = np.radians(1.0)
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    calibrations = {
        "exchanged": replace(right, psf=right.psf[::-1].copy()),
        "turned": replace(right, psf=np.swapaxes(right.psf, 2, 3).copy()),
        "a sensor rotated by 1 degree": replace(right, centre_um=right.centre_um @ rotation.T),
        "images 3 % too large": replace(right, centre_um=1.03 * right.centre_um),
    }
    assert "calibration" in str(decode(photographed(*which), calibrations[wrong]).figures.warning)
