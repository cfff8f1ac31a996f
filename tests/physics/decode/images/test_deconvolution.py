"""All-in-focus images: each depth's filter where its pixels are, and transfer functions that are kept."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from metafab.camera import RawFrame, capture
from metafab.decode import Decoder, DecoderNumerics
from metafab.decode.images.deconvolution import Deconvolver, SharpImages
from metafab.optics.point_spread import Psf
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf

SCENE = Scene(objects=(SceneObject(depth_m=0.0030, size=(0.2, 0.2)),), field_px=(90, 120), seed=4)
DEPTHS_PER_M = 1.0 / np.array([0.0028, 0.0032])


@pytest.fixture(scope="module")
def psf() -> Psf:
    tangents = np.linspace(-0.12, 0.12, 3)
    return helix_psf(1.0 / np.linspace(1 / 0.00245, 1 / 0.0036, 9), window_px=32, tangents=(tangents, tangents))


@pytest.fixture(scope="module")
def frame(psf: Psf) -> RawFrame:
    return capture(SCENE, psf)


def sharp(decoder: Decoder, frame: RawFrame, label: np.ndarray) -> SharpImages:
    seen = decoder.prepare(frame)
    assert not isinstance(seen, str)
    # Tiles of their own, so that a kept transfer function belongs to one of several.
    tiling = dataclasses.replace(decoder.deconvolver.tiling, core=(45, 40), size=(120, 120), counts=(2, 3))
    deconvolver = Deconvolver(decoder.calibration, tiling)
    tiles = deconvolver.tile_spectra(seen.twins.image, label > 0)
    return deconvolver(tiles, seen.levels, label.astype(np.int32), DEPTHS_PER_M, seen.twins.broken)


def test_each_pixel_is_as_sharp_as_if_all_lay_at_its_depth(psf: Psf, frame: RawFrame) -> None:
    decoder = Decoder.of(psf, frame.frame.shape, frame.origin_um, frame.x_window)
    assert decoder is not None
    label = np.random.default_rng(1).integers(0, 3, SCENE.field_px)
    mixed = sharp(decoder, frame, label)
    for number in (1, 2):
        alone = sharp(decoder, frame, np.full(SCENE.field_px, number))
        mask = label == number
        np.testing.assert_array_equal(mixed.images[:, mask], alone.images[:, mask])
        np.testing.assert_array_equal(mixed.noise_gain[:, mask], alone.noise_gain[:, mask])
    assert not mixed.images[:, label == 0].any()
    assert not mixed.noise_gain[:, label == 0].any()


def test_broken_pixels_across_an_outline_are_filled_in_at_one_depth(psf: Psf, frame: RawFrame) -> None:
    """Three quarters of a hole lie in segment 1: its image is as if segment 2 began elsewhere."""
    decoder = Decoder.of(psf, frame.frame.shape, frame.origin_um, frame.x_window)
    assert decoder is not None
    assert frame.x_window is not None
    row, column = frame.x_window[0] + 40, frame.x_window[1] + 50
    values = frame.frame.copy()
    values[row : row + 8, column : column + 8] = np.nan
    holed = dataclasses.replace(frame, frame=values)
    left = np.broadcast_to(np.arange(SCENE.field_px[1]) < 56, SCENE.field_px)
    seen = decoder.prepare(holed)
    assert not isinstance(seen, str)
    assert [int((seen.twins.bad & side).sum()) for side in (left, ~left)] == [48, 16]
    parted, whole = (sharp(decoder, holed, label) for label in (np.where(left, 1, 2), np.ones(SCENE.field_px, int)))
    np.testing.assert_array_equal(parted.images[:, left], whole.images[:, left])


def test_overwritten_pixels_leave_all_others(psf: Psf, frame: RawFrame) -> None:
    decoder = Decoder.of(psf, frame.frame.shape, frame.origin_um, frame.x_window)
    assert decoder is not None
    seen = decoder.prepare(frame)
    assert not isinstance(seen, str)
    label = np.zeros(SCENE.field_px, dtype=np.int32)
    label[20:61, 33:70] = 1
    label[30:40, 40:90] = 2
    tiles = decoder.deconvolver.tile_spectra(seen.twins.image, label > 0)
    fresh = decoder.deconvolver(tiles, seen.levels, label, DEPTHS_PER_M)
    over = SharpImages(*np.full((2, 2, *SCENE.field_px), -7.0, dtype=np.float32))
    over.overwrite(fresh, label > 0)
    for written, want in ((over.images, fresh.images), (over.noise_gain, fresh.noise_gain)):
        np.testing.assert_array_equal(written[:, label > 0], want[:, label > 0])
        assert (written[:, label == 0] == -7.0).all()


def test_what_is_kept_is_bounded_and_changes_nothing(psf: Psf, frame: RawFrame) -> None:
    decoder = Decoder.of(psf, frame.frame.shape, frame.origin_um, frame.x_window)
    assert decoder is not None
    first = decoder(frame)
    kept = decoder.deconvolver.nbytes
    again = decoder(frame)
    assert decoder.deconvolver.nbytes == kept > 0
    forgetful = Decoder.of(psf, frame.frame.shape, frame.origin_um, frame.x_window, DecoderNumerics(kept_bytes=1))
    assert forgetful is not None
    last = forgetful(frame)
    n_y, n_x = forgetful.deconvolver.tiling.size
    assert forgetful.deconvolver.nbytes < 2 * n_y * n_x * 8
    for image in (again, last):
        np.testing.assert_array_equal(image.intensity_x, first.intensity_x)


def test_another_calibrations_restorer_keeps_nothing_of_the_first(psf: Psf, frame: RawFrame) -> None:
    other = helix_psf(1.0 / np.linspace(1 / 0.0026, 1 / 0.0034, 9), window_px=32)
    mine, its = (Decoder.of(one, frame.frame.shape, frame.origin_um, frame.x_window) for one in (psf, other))
    assert mine is not None
    assert its is not None
    key = (3, 0)
    (first,) = mine.deconvolver.transfers([key])
    (want,) = Deconvolver(its.calibration, mine.deconvolver.tiling).transfers([key])
    assert not np.allclose(first, want)
    (got,) = dataclasses.replace(mine.deconvolver, calibration=its.calibration).transfers([key])
    np.testing.assert_array_equal(got, want)


def test_tiles_of_one_pair_share_its_transfer_function(psf: Psf, frame: RawFrame) -> None:
    decoder = Decoder.of(dataclasses.replace(psf, field=None), frame.frame.shape, frame.origin_um, frame.x_window)
    assert decoder is not None
    tiling = dataclasses.replace(decoder.deconvolver.tiling, core=(45, 40), size=(120, 120), counts=(2, 3))
    one, other = Deconvolver(decoder.calibration, tiling).transfers([(3, 0), (3, 5)])
    assert one is other
