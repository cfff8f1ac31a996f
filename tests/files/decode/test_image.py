"""decoded.h5: what goes in comes out."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile

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
    untimed = dataclasses.replace(image.figures, seconds=None)
    assert (back.segments, back.nmae, back.figures) == (image.segments, image.nmae, untimed)
    assert (back.origin_um, back.pixel_um) == (image.origin_um, image.pixel_um)
    with h5py.File(tmp_path / "decoded.h5") as file:
        assert file["depth_m"].attrs["units"] == "m"
        assert file["depth_m"].dims[1].keys() == ["x_um"]


@pytest.mark.parametrize("bits", [8, 12, 16])
def test_a_cameras_counts_give_the_depths_of_the_electrons(psf: Psf, tmp_path: Path, bits: int) -> None:
    """A TIFF knows neither the field stop nor where the axis is; the twins' distance is all that matters."""
    scene = Scene(objects=(SceneObject(depth_m=0.0029, size=(0.1, 0.1)),), seed=2)
    frame = capture(scene, psf)
    full = 0.8 * (2**bits - 1) / frame.frame.max()
    counts = np.clip(np.round(frame.frame * full), 0, 2**bits - 1).astype(np.uint8 if bits == 8 else np.uint16)
    tifffile.imwrite(tmp_path / "frame.tif", counts[::-1])
    image = decode(load_frame(tmp_path / "frame.tif", psf), psf)
    assert image.nmae is None
    biggest = max(image.segments, key=lambda row: row.pixels)
    # The electrons' own error on 62 x 62 pixels is near 0.3 %: three of them.
    assert biggest.depth_m == pytest.approx(0.0029, rel=0.01)


def test_an_undecodable_frame_can_be_saved(psf: Psf, tmp_path: Path) -> None:
    np.save(tmp_path / "black.npy", np.zeros((200, 400), dtype=np.uint16))
    save(decode(load_frame(tmp_path / "black.npy", psf), psf), tmp_path / "decoded.h5")
    assert load(tmp_path / "decoded.h5").figures.reason


def test_a_raw_frame_is_no_decoded_image(tmp_path: Path) -> None:
    (tmp_path / "decoded.h5").write_bytes(b"raw")
    with pytest.raises(InputError, match="metafab decode"):
        load(tmp_path / "decoded.h5")
