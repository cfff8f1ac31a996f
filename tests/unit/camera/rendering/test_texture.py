"""Textures and their contrast."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from metafab.camera.rendering.texture import make_texture
from metafab.core.errors import InputError
from metafab.spec import SceneObject


@pytest.mark.parametrize("kind", ["fractal", "checker"])
def test_textures_have_mean_one_and_the_asked_contrast(kind: str) -> None:
    spec = SceneObject(depth_m=1.0, texture=kind, texture_contrast=0.25)
    texture = make_texture(spec, (96, 96), np.random.default_rng(1))
    place = (np.arange(384) + 0.5) / 384
    values = texture(*np.meshgrid(place, place))
    # Cubic sampling between texels smooths a 1/f pattern by some per cent.
    assert values.mean() == pytest.approx(1.0, abs=0.01)
    assert values.std() == pytest.approx(0.25, rel=0.06)
    assert values.min() >= 0.0


def test_a_picture_as_texture_keeps_its_top_up(tmp_path: Path) -> None:
    picture = np.zeros((32, 32))
    picture[:16] = 200.0  # the picture's upper half is bright
    np.save(tmp_path / "picture.npy", picture)
    spec = SceneObject(depth_m=1.0, texture="image", texture_file=tmp_path / "picture.npy", texture_contrast=0.3)
    texture = make_texture(spec, (8, 8), np.random.default_rng(1))
    assert texture(np.array([0.5]), np.array([0.8]))[0] > 1.2
    assert texture(np.array([0.5]), np.array([0.2]))[0] < 0.8


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200])
def test_a_picture_with_values_that_are_no_light_is_refused_by_name(tmp_path: Path, value: float) -> None:
    np.save(tmp_path / "picture.npy", np.where(np.eye(8), value, 1.0))
    spec = SceneObject(depth_m=1.0, texture="image", texture_file=tmp_path / "picture.npy")
    with pytest.raises(InputError, match=r"`texture_file`: expected finite values .*, got 8 others in .*npy"):
        make_texture(spec, (8, 8), np.random.default_rng(1))
