"""A part of a frame by itself gives what the whole frame gives there."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from metafab.camera import RawFrame, capture
from metafab.core.parallel.progress import silent
from metafab.decode import Decoder
from metafab.decode.registration.twins import extract, extract_part
from metafab.optics.point_spread import Psf
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf

SCENE = Scene(
    objects=(SceneObject(depth_m=0.0030, size=(0.3, 0.3)),), field_px=(150, 170), seed=4, photons_per_pixel=3000.0
)


@pytest.fixture(scope="module")
def psf() -> Psf:
    tangents = np.linspace(-0.15, 0.15, 3)
    return helix_psf(1.0 / np.linspace(1 / 0.00245, 1 / 0.0036, 9), tangents=(tangents, tangents))


@pytest.fixture(scope="module")
def frame(psf: Psf) -> RawFrame:
    return capture(SCENE, psf)


@pytest.fixture(scope="module")
def decoder(psf: Psf, frame: RawFrame) -> Decoder:
    found = Decoder.of(psf, frame.frame.shape, frame.origin_um, frame.x_window)
    assert found is not None
    return found


@pytest.mark.parametrize("broken", [None, np.nan, 1e18])
def test_a_part_of_both_images_is_that_of_the_whole(frame: RawFrame, decoder: Decoder, broken: float | None) -> None:
    grid = decoder.calibration.grid
    if broken is not None:
        values = frame.frame.copy()
        # Inside, on the seam of the part below, and beside it.
        for row in (60, 31, 30, 29, 26):
            values[grid.row + grid.margin + row, grid.column + grid.margin + 50] = broken
        frame = dataclasses.replace(frame, frame=values)
    whole, m = extract(frame, grid), grid.margin
    for rows, columns in (
        (slice(30, 90), slice(40, 120)),
        (slice(0, 24), slice(0, 24)),
        (slice(100, 150), slice(150, 170)),
    ):
        image, broken = extract_part(frame, grid, rows, columns)
        wide = slice(rows.start, rows.stop + 2 * m), slice(columns.start, columns.stop + 2 * m)
        np.testing.assert_array_equal(broken, whole.broken[:, *wide])
        np.testing.assert_array_equal(image, whole.image[:, *wide])


def test_a_part_of_the_volume_is_that_of_the_whole(frame: RawFrame, decoder: Decoder) -> None:
    """But for what the images' reduction, whose filter has long tails, mixes in from beyond the part's margin."""
    seen = decoder.prepare(frame)
    assert not isinstance(seen, str)
    whole = decoder.match(seen).volume
    block, step = decoder.filters.block, decoder.filters.downsampling.step
    part = slice(2 * block, 6 * block), slice(4 * block, 9 * block)
    filters = decoder.filters.within(*part)
    assert filters.downsampling.shape == (4 * block, 5 * block)
    rows, columns = (slice(step * at.start, step * at.stop) for at in part)
    image, _ = extract_part(frame, decoder.calibration.grid, rows, columns)
    got = filters.volume(filters.downsampling.spectra(image), seen.levels, seen.lit[part], silent)
    want = whole.products[:, :, *part]
    assert np.sqrt(np.mean((got.products - want) ** 2) / np.mean(want**2)) < 0.03
    assert got.samples == pytest.approx(whole.samples, rel=0.02)
    assert got.noise_gain == pytest.approx(whole.noise_gain, rel=0.02)


def test_a_part_at_the_end_of_the_window_ends_with_it(decoder: Decoder) -> None:
    downsampling, block = decoder.filters.downsampling, decoder.filters.block
    rows, columns = (slice((n - 1) // block * block, n) for n in downsampling.shape)
    part = decoder.filters.within(rows, columns)
    assert part.downsampling.shape == (rows.stop - rows.start, columns.stop - columns.start)
    assert part.weights.shape[1:3] == (1, 1)
    np.testing.assert_array_equal(part.weights[:, 0, 0], decoder.filters.weights[:, -1, -1])
    assert part.basis is decoder.filters.basis


def test_parts_of_one_size_share_their_transforms_and_other_kernels_none(decoder: Decoder) -> None:
    filters, block = decoder.filters, decoder.filters.block
    one, two = (filters.within(slice(at, at + 3 * block), slice(0, 2 * block)) for at in (0, 2 * block))
    first, second = (part.basis.transforms(part.downsampling)[0] for part in (one, two))
    assert first is second
    other = dataclasses.replace(filters.basis, kernels=2.0 * filters.basis.kernels)
    np.testing.assert_array_equal(other.transforms(one.downsampling)[0], 2.0 * first)
