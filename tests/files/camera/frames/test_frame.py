"""raw.h5: frames survive their file, and broken files are refused with a reason."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from metafab.camera import RawFrame, capture, load, save
from metafab.core.errors import InputError
from metafab.core.storage.hdf5 import SEAL_BYTES
from metafab.optics.point_spread import Psf
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf


@pytest.fixture(scope="module")
def psf() -> Psf:
    return helix_psf(np.linspace(0.0027, 0.0032, 3), window_px=32)


@pytest.fixture(scope="module")
def frame(psf: Psf) -> RawFrame:
    return capture(Scene(objects=(SceneObject(depth_m=0.003, size=(0.04, 0.04)),), field_px=(40, 48)), psf)


def test_a_frame_survives_its_file(frame: RawFrame, tmp_path: Path) -> None:
    save(frame, tmp_path / "raw.h5")
    back = load(tmp_path / "raw.h5")
    assert (back.frame == frame.frame).all()
    assert (back.pixel_um, back.origin_um, back.x_window) == (frame.pixel_um, frame.origin_um, frame.x_window)
    assert back.truth is not None
    assert frame.truth is not None
    np.testing.assert_array_equal(back.truth.depth_m, frame.truth.depth_m)
    assert (back.truth.label == frame.truth.label).all()
    assert back.truth_origin_um == frame.truth_origin_um


def test_datasets_have_units_descriptions_and_scales(frame: RawFrame, tmp_path: Path) -> None:
    save(frame, tmp_path / "raw.h5")
    with h5py.File(tmp_path / "raw.h5") as file:
        for name in ("frame", "truth/depth_m", "truth/intensity_x", "truth/intensity_y", "truth/label"):
            assert file[name].attrs["units"]
            assert file[name].attrs["description"]
            assert file[name].dims[0].keys() == ["y_um"]
            assert file[name].dims[1].keys() == ["x_um"]


def test_a_frame_of_too_many_pixels_is_refused_before_it_is_read(frame: RawFrame, tmp_path: Path) -> None:
    """A file of some kilobytes states 25 million zeros, each of which takes 59 bytes to decode."""
    path = tmp_path / "raw.h5"
    save(frame, path)
    path.write_bytes(path.read_bytes()[:-SEAL_BYTES])
    with h5py.File(path, "r+") as file:
        del file["frame"]
        file.create_dataset("frame", (5000, 5000), "u1", chunks=(1000, 1000), compression="gzip")
    with pytest.raises(InputError, match=r"at most 1\.26e\+07 values"):
        load(path)


@pytest.mark.parametrize("kind", ["missing", "empty", "foreign", "truncated"])
def test_broken_files_are_refused(frame: RawFrame, tmp_path: Path, kind: str) -> None:
    path = tmp_path / "raw.h5"
    if kind == "empty":
        path.touch()
    elif kind == "foreign":
        h5py.File(path, "w").close()
    elif kind == "truncated":
        save(frame, path)
        path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(InputError, match="metafab raw frame"):
        load(path)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("pixel_um", 0.0),
        ("pixel_um", np.nan),
        ("read_noise_e", -1.0),
        ("saturation_e", 0.0),
        ("origin_um", np.array([np.nan, 0.0])),
        ("origin_um", np.array([1e300, 0.0])),
        ("x_window", np.array([0, 0, 10**6, 8])),
        ("x_window", np.array([-1, 0, 8, 8])),
    ],
)
def test_frames_that_say_impossible_things_are_refused(
    frame: RawFrame, tmp_path: Path, name: str, value: float | np.ndarray
) -> None:
    save(frame, tmp_path / "raw.h5")
    with h5py.File(tmp_path / "raw.h5", "r+") as file:
        file.attrs[name] = value
    with pytest.raises(InputError) as caught:
        load(tmp_path / "raw.h5")
    assert [fault.field for fault in caught.value.faults] == [name]


def test_truth_of_unequal_shapes_is_refused(frame: RawFrame, tmp_path: Path) -> None:
    save(frame, tmp_path / "raw.h5")
    with h5py.File(tmp_path / "raw.h5", "r+") as file:
        del file["truth/label"]
        file["truth/label"] = np.zeros((3, 3), dtype=np.int32)
    with pytest.raises(InputError, match="one shape"):
        load(tmp_path / "raw.h5")
