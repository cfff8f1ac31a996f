"""decoded.h5: what goes in comes out."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from metafab.camera import capture, load_frame
from metafab.core.errors import InputError
from metafab.decode import decode, load, save
from metafab.optics.point_spread import Psf
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf


@pytest.fixture(scope="module")
def psf() -> Psf:
    return helix_psf(np.linspace(0.0025, 0.0034, 7))


def test_a_decoded_image_survives_its_file(psf: Psf, tmp_path: Path) -> None:
    image = decode(capture(Scene(objects=(SceneObject(depth_m=0.003, size=(0.08, 0.08)),)), psf), psf)
    save(image, tmp_path / "decoded.h5", inputs_sha256="abc")
    back = load(tmp_path / "decoded.h5")
    for name in ("intensity_x", "intensity_y", "contrast", "depth_m", "confidence", "segment", "depth_pixel_m"):
        np.testing.assert_array_equal(getattr(back, name), getattr(image, name))
    assert (back.segments, back.nmae, back.details) == (image.segments, image.nmae, image.details)
    assert (back.origin_um, back.pixel_um) == (image.origin_um, image.pixel_um)
    with h5py.File(tmp_path / "decoded.h5") as file:
        assert file["depth_m"].attrs["units"] == "m"
        assert file["depth_m"].dims[1].keys() == ["x_um"]


def test_an_undecodable_frame_can_be_saved(psf: Psf, tmp_path: Path) -> None:
    np.save(tmp_path / "black.npy", np.zeros((200, 400), dtype=np.uint16))
    save(decode(load_frame(tmp_path / "black.npy", psf), psf), tmp_path / "decoded.h5")
    assert load(tmp_path / "decoded.h5").details["reason"]


def test_a_raw_frame_is_no_decoded_image(tmp_path: Path) -> None:
    (tmp_path / "decoded.h5").write_bytes(b"raw")
    with pytest.raises(InputError, match="metafab decode"):
        load(tmp_path / "decoded.h5")
