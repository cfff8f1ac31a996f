"""Block sums: compiled against plain, whatever the tiles, and coarser ones as sums of four."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from metafab.optics.geometry.path import Ray, power_at_aperture
from metafab.optics.propagation.pupil import Carrier, Pupil, expansion_error_rad, reduce_field
from metafab.optics.sources.source import FieldTile, Source
from tests import optics_lens as lens

OPTICS = lens.imaging()
K = OPTICS.wavenumber


def _ray(polarisation: int = 0, tangent: tuple[float, float] = (0.03, -0.05)) -> Ray:
    return Ray.towards_image(OPTICS, polarisation, 0.9e-3, tangent)


def _exact(source: Source, carrier: Carrier) -> Pupil:
    """Block sums with the exact path at every site, by NumPy: the oracle of the compiled pass."""
    (pupil,) = reduce_field(source, [carrier], K)
    sums, power = np.zeros_like(pupil.sums), np.zeros_like(pupil.power)
    x_um, y_um, block = source.lattice.x_um(), source.lattice.y_um(), carrier.block_sites
    for tile in source.tiles():
        amplitude = tile.amplitude(carrier.polarisation)
        rows, columns = tile.row + np.arange(amplitude.shape[0]), tile.column + np.arange(amplitude.shape[1])
        x, y = x_um[None, columns], y_um[rows, None]
        field = amplitude * np.exp(1j * K * carrier.ray.path_um(x, y))
        there = np.ix_(rows // block, columns // block)
        place = tuple(np.broadcast_arrays(*there))
        np.add.at(sums[0], place, field)
        np.add.at(sums[1], place, field * (x - pupil.x_um[there[1]]))
        np.add.at(sums[2], place, field * (y - pupil.y_um[there[0]]))
        np.add.at(power, place, np.abs(field) ** 2)
    return replace(pupil, sums=sums, power=power)


@pytest.mark.parametrize("block", [1, 3, 8])
@pytest.mark.parametrize("make", [lens.written, lens.ideal])
def test_the_compiled_pass_is_the_plain_one(block: int, make: Callable[..., Source]) -> None:
    """They differ by what the pass does not follow; moments, by that times half a block."""
    source = make(OPTICS, lens.eq_2(OPTICS), lens.eq_3_and_4(OPTICS))
    carrier = Carrier(0, _ray(), block)
    (fast,) = reduce_field(source, [carrier], K)
    exact = _exact(source, carrier)
    bound = 2.0 * expansion_error_rad(source, carrier.ray, K, block) + 1e-9
    assert np.abs(fast.sums - exact.sums).max() <= bound * 0.9 * block**2
    assert fast.power == pytest.approx(exact.power, abs=1e-9)


def test_tiles_leave_no_trace() -> None:
    terms = lens.eq_2(OPTICS), lens.eq_3_and_4(OPTICS)
    carrier = Carrier(1, _ray(1), 4)
    (one,) = reduce_field(lens.written(OPTICS, *terms, tile_sites=400), [carrier], K)
    (many,) = reduce_field(lens.written(OPTICS, *terms, tile_sites=17), [carrier], K)
    assert np.abs(one.sums - many.sums).max() < 1e-10 * np.abs(one.sums).max()


def test_every_row_of_tiles_gives_memory_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tiles without pillars are left out: at the rim of a circle, the first of a row."""
    whole = lens.written(OPTICS, lens.eq_2(OPTICS), tile_sites=100)
    rim = replace(whole.pillars, tiles=lambda: (tile for tile in whole.pillars.tiles() if tile.column))
    source = replace(whole, pillars=rim)
    released: list[object] = []
    monkeypatch.setattr("metafab.optics.propagation.pupil.release", released.append)
    reduce_field(source, [Carrier(0, _ray(), 4)], K)
    assert len(released) == 2 * len({tile.row for tile in source.tiles()}) > 2, "sums and powers, once a row"


def test_coarsening_is_the_same_as_larger_blocks() -> None:
    source = lens.ideal(OPTICS, lens.eq_2(OPTICS), lens.eq_3_and_4(OPTICS))
    fine, coarse = (_exact(source, Carrier(0, _ray(), block)) for block in (3, 6))
    coarsened = fine.coarsened()
    assert coarsened.x_um == pytest.approx(coarse.x_um) and coarsened.y_um == pytest.approx(coarse.y_um)
    assert np.abs(coarsened.sums - coarse.sums).max() < 1e-10 * np.abs(coarse.sums).max()
    assert coarsened.power == pytest.approx(coarse.power)


def test_a_tile_of_amplitudes_is_an_index_into_them() -> None:
    """Tiles above 2^16 sites need a longer index; both give back what they were made of."""
    for shape in ((3, 5), (300, 300)):
        amplitudes = np.arange(2.0 * shape[0] * shape[1]).reshape(2, *shape) * (1.0 - 2.0j)
        tile = FieldTile(0, 0, amplitudes=amplitudes)
        index, table = tile.indexed(1)
        assert np.array_equal(table[index], tile.amplitude(1))


def test_all_light_through_an_ideal_aperture_arrives() -> None:
    """Sites inside the outline against its exact integral: the rim's sites make the difference, N^(-3/2) of it."""
    source = lens.ideal(OPTICS, lens.eq_3_and_4(OPTICS))
    ray = _ray()
    (pupil,) = reduce_field(source, [Carrier(0, ray, 2)], K)
    across = source.lattice.shape[0]
    assert pupil.transmitted(ray) / power_at_aperture(OPTICS, ray) == pytest.approx(1.0, abs=2.0 * across**-1.5)


def test_a_dark_mask_lets_nothing_through() -> None:
    source = lens.written(OPTICS, lens.eq_3_and_4(OPTICS))
    source.table[:] = 0.0
    (pupil,) = reduce_field(source, [Carrier(0, _ray(), 4)], K)
    assert not pupil.sums.any() and not pupil.power.any()


def test_a_dark_pupil_has_no_sub_apertures() -> None:
    (pupil,) = reduce_field(lens.ideal(OPTICS, lens.eq_3_and_4(OPTICS)), [Carrier(0, _ray(), 4)], K)
    points_um = pupil.sub_apertures_um
    assert points_um is not None and points_um.shape == (128, 2)
    assert replace(pupil, power=np.zeros_like(pupil.power)).sub_apertures_um is None


def test_bands_of_a_large_pupil_leave_no_trace() -> None:
    """1.4 million blocks are six bands; rows and columns are odd in number."""
    random, shape = np.random.default_rng(5), (1201, 1203)
    x_um, y_um = (2.8 * (np.arange(count) - count // 2) for count in shape[::-1])
    sums = random.normal(size=(3, *shape)) + 1j * random.normal(size=(3, *shape))
    pupil = Pupil(Carrier(0, _ray(), 8), K, (0.35, 0.35), 0.35**2, x_um, y_um, sums, random.random(shape))
    assert [rows.start % 2 for rows, _ in pupil.bands()] == 6 * [0]
    assert np.array_equal(np.concatenate([band.sums for _, band in pupil.bands()], axis=1), sums)
    padded = np.pad(pupil.sums, ((0, 0), (0, 1), (0, 1))).reshape(3, 601, 2, 602, 2)
    side = 1.4 * np.array([-1.0, 1.0])
    coarse = pupil.coarsened()
    assert np.allclose(coarse.sums[0], padded[0].sum(axis=(1, 3)), atol=1e-9)
    assert np.allclose(coarse.sums[1], (padded[1] + side * padded[0]).sum(axis=(1, 3)), atol=1e-9)
    assert np.allclose(coarse.sums[2], (padded[2] + side[:, None, None] * padded[0]).sum(axis=(1, 3)), atol=1e-9)
    assert coarse.power.sum() == pytest.approx(pupil.power.sum())
    flux = _ray().incident_amplitude(x_um[None, :], y_um[:, None]) ** 2
    assert pupil.transmitted(_ray()) == pytest.approx(np.sum(flux * pupil.power) * 0.35**2)


def test_flat_pupils_have_no_empty_bands() -> None:
    for shape in ((1, 600_000), (3, 300_000), (600_000, 1)):
        axes = (np.arange(float(count)) for count in shape[::-1])
        pupil = Pupil(Carrier(0, _ray(), 1), K, (1.0, 1.0), 1.0, *axes, np.ones((3, *shape), complex), np.ones(shape))
        sizes = [band.power.size for _, band in pupil.bands()]
        assert sum(sizes) == pupil.power.size and min(sizes) > 0
