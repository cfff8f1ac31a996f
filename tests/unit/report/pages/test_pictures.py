"""Pictures of single results: of a full-Stokes frame every panel shows its own values, dark pixels no polarisation."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from matplotlib import colormaps
from PIL import Image

from metafab.camera.stokes import StokesFrame
from metafab.decode.stokes import StokesImage
from metafab.library.library import Library
from metafab.report import library_figure, stokes_figure
from metafab.report.style import CONTRAST_MAP, DEPTH_MAP

#: S1/S0, S2/S0, S3/S0 of the left and right half of the scene.
LEFT, RIGHT = (0.8, -0.4, 0.0), (-0.8, 0.4, 0.6)


def _scene() -> tuple[StokesFrame, StokesImage]:
    n_y, n_x = 40, 60
    s0 = np.zeros((n_y, n_x))
    s0[8:32, 10:50] = 1000.0
    ratio = np.where(np.arange(n_x) < n_x // 2, np.array(LEFT)[:, None], np.array(RIGHT)[:, None])
    stokes = np.concatenate([s0[None], ratio[:, None, :] * s0])
    depth_m = np.where(s0 > 0.0, 0.3, np.nan)
    frame = StokesFrame(np.stack([s0] * 6), 2.0, stokes, depth_m, (s0 > 0.0).astype(np.int32))
    return frame, StokesImage(stokes, depth_m, np.ones_like(s0))


@pytest.fixture(scope="module")
def picture(tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    path = stokes_figure(*_scene(), tmp_path_factory.mktemp("stokes") / "stokes.png")
    return np.asarray(Image.open(path).convert("RGB"), dtype=np.int64)


def _colour(share: float) -> np.ndarray:
    """Of a normalised Stokes parameter on its scale from -1 to 1."""
    return np.rint(255.0 * np.array(CONTRAST_MAP(0.5 + 0.5 * share)[:3])).astype(np.int64)


@pytest.mark.parametrize("share", sorted({*LEFT, *RIGHT} - {0.0}))
def test_normalised_parameters_have_the_colours_of_their_values(picture: np.ndarray, share: float) -> None:
    """An area of a panel's half is some thousand pixels; colours of a bar's gradient alone are a few hundred."""
    near = np.abs(picture - _colour(share)).max(axis=2) <= 2
    lower = near[near.shape[0] // 2 :]
    assert lower.sum() > 1500
    rows, columns = np.nonzero(lower)
    assert np.ptp(columns) > 10 and np.ptp(rows) > 10


def test_both_depths_have_one_scale(tmp_path: Path) -> None:
    """Of a surface that is decoded nearer than it is, the two panels have the two ends of the scale."""
    frame, image = _scene()
    near = dataclasses.replace(image, depth_m=0.8 * image.depth_m)
    drawn = np.asarray(Image.open(stokes_figure(frame, near, tmp_path / "s.png")).convert("RGB"), dtype=np.int64)
    places = []
    for end in (0.0, 1.0):
        colour = np.rint(255.0 * np.array(colormaps[DEPTH_MAP](end)[:3]))
        at = np.abs(drawn - colour).max(axis=2) <= 2
        assert at.sum() > 3000
        places.append(float(np.median(np.nonzero(at)[1])) / drawn.shape[1])
    assert 4 / 6 < places[0] < 5 / 6 < places[1]


def test_nothing_is_cut_at_the_rim(picture: np.ndarray) -> None:
    assert picture[:, -2:].min() == picture[:2].min() == picture[-2:].min() == 255


def test_the_same_frame_gives_the_same_bytes(tmp_path: Path) -> None:
    paths = [stokes_figure(*_scene(), tmp_path / name) for name in ("a.png", "b.png")]
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_library_picture_is_written(smooth_library: Library, tmp_path: Path) -> None:
    path = library_figure(smooth_library, tmp_path / "library.png")
    assert path.read_bytes().startswith(b"\x89PNG")
