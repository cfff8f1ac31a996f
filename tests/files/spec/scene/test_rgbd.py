"""Files of a picture with its depth: each fault is headed by its own file and says what to do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.spec import load_scene
from metafab.spec.scene import Rgbd

SHAPE = (4, 6)
RANGE_M = (0.3, 0.6)


def table(folder: Path, **arrays: FloatArray) -> Rgbd:
    """A table whose files hold light of 1 and two depths, or the arrays given."""
    depth_m = np.full(SHAPE, 0.5)
    depth_m[:, 3:] = 0.4
    for name, values in ({"image": np.ones(SHAPE), "depth": depth_m, "contrast": np.ones(SHAPE)} | arrays).items():
        np.save(folder / f"{name}.npy", values)
    return Rgbd(**{f"{name}_file": folder / f"{name}.npy" for name in ("image", "depth", "contrast")})


def scaled(folder: Path, depth: FloatArray) -> Rgbd:
    """A table whose depths are scaled into :data:`RANGE_M`."""
    made = table(folder, depth=depth)
    return Rgbd(made.image_file, made.depth_file, None, RANGE_M)


def refusal(made: Rgbd) -> InputError:
    with pytest.raises(InputError) as refused:
        made.arrays()
    return refused.value


@pytest.mark.parametrize("name", ["depth", "contrast"])
def test_a_wrong_shape_is_the_fault_of_its_file(name: str, tmp_path: Path) -> None:
    error = refusal(table(tmp_path, **{name: np.ones((4, 5))}))
    assert error.source == str(tmp_path / f"{name}.npy")
    (fault,) = error.faults
    assert (fault.field, fault.got) == (f"rgbd.{name}_file", "(4, 5)")
    assert "(4, 6), that of image.npy" in fault.expected and "one shape" in fault.remedy


def test_faults_of_all_files_are_told_at_once(tmp_path: Path) -> None:
    error = refusal(table(tmp_path, image=-np.ones(SHAPE), depth=-np.ones(SHAPE), contrast=np.zeros(SHAPE)))
    assert error.source == "scene" and len(error.faults) == 3
    for name in ("image", "depth", "contrast"):
        assert f"`rgbd.{name}_file -> {tmp_path / name}.npy`: expected" in str(error)
    both = refusal(table(tmp_path, depth=np.ones((3, 3)), contrast=np.ones((2, 2))))
    assert [fault.field.split(" ")[0] for fault in both.faults] == ["rgbd.depth_file", "rgbd.contrast_file"]


@pytest.mark.parametrize("name", ["image", "depth", "contrast"])
@pytest.mark.parametrize("values", [np.ones(SHAPE, complex), np.full(SHAPE, "a"), np.ones(5)], ids=["i", "text", "1d"])
def test_an_array_of_another_kind_is_named_with_its_key_and_a_remedy(
    name: str, values: FloatArray, tmp_path: Path
) -> None:
    error = refusal(table(tmp_path, **{name: values}))
    assert error.source == str(tmp_path / f"{name}.npy")
    (fault,) = error.faults
    assert fault.field == f"rgbd.{name}_file" and fault.remedy


@pytest.mark.parametrize("name", ["image", "depth", "contrast"])
@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
def test_values_out_of_range_have_a_remedy(name: str, value: float, tmp_path: Path) -> None:
    values = np.ones(SHAPE)
    values[0, 0] = value
    if name == "depth" and not np.isfinite(value):
        assert np.isnan(table(tmp_path, depth=values).arrays().depth_m[0, 0])
        return
    (fault,) = refusal(table(tmp_path, **{name: values})).faults
    assert f"values such as {value:g} in 1 of 24 pixels" in fault.got and fault.remedy


def test_infinite_depths_are_unknown(tmp_path: Path) -> None:
    """As in the disparities of Middlebury, whose unknown pixels are infinite."""
    values = np.full(SHAPE, 0.5)
    values[0, :3] = np.inf, -np.inf, np.nan
    depth_m = table(tmp_path, depth=values).arrays().depth_m
    assert np.isnan(depth_m[0, :3]).all() and (depth_m[1:] == 0.5).all()


@pytest.mark.parametrize(
    ("depth", "message"),
    [
        (np.full(SHAPE, 7), "several depths to scale into `depth_range_m`, got 7 everywhere; leave"),
        (np.full(SHAPE, 0), "no value is above 0"),
        (np.where(np.eye(*SHAPE) > 0, 1e308, -1e308), "at most 1e.15, got -1e.308 to 1e.308"),
    ],
)
def test_depths_that_cannot_be_scaled_are_refused(depth: FloatArray, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        scaled(tmp_path, depth).depths_m()


@pytest.mark.parametrize("unit", [1e-320, 1e14])
def test_scaled_depths_have_any_unit(unit: float, tmp_path: Path) -> None:
    depth_m = scaled(tmp_path, np.where(np.eye(*SHAPE) > 0, 3.0, 1.0) * unit).depths_m()
    assert (depth_m.min(), depth_m.max()) == pytest.approx(RANGE_M)


BAD_RANGES = ["[0.3]", "[]", "[0.1, 0.2, 0.3]", "[0.6, 0.3]", "[0.3, 0.3]", "[0.0, 0.3]", "[nan, 0.3]", "[0.3, inf]"]
NO_RANGES = ['["a", "b"]', "[true, false]", "0.3", '"a"', "[[0.1, 0.2]]", "{near = 0.1, far = 0.2}"]


@pytest.mark.parametrize("value", [*BAD_RANGES, *NO_RANGES])
def test_a_bad_range_is_one_fault_that_says_what_it_must_be(value: str, tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(f'[rgbd]\nimage_file = "a.png"\ndepth_file = "b.npy"\ndepth_range_m = {value}\n')
    with pytest.raises(InputError) as refused:
        load_scene(path)
    (fault,) = refused.value.faults
    assert fault.field == "rgbd.depth_range_m"
    assert "[near, far], two depths in m with 0 < near < far" in fault.expected
    assert fault.got or value.startswith("{")
