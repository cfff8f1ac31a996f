"""Printed sizes and corrected doses of a lens."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.special import erf, erfcinv

from metafab.core.errors import InputError
from metafab.exposure import (
    BeamPsf,
    BeamTerm,
    Beside,
    ExposedLens,
    ExposureNumerics,
    ExposureRecord,
    OtherLens,
    SizeErrors,
    expose,
    expose_lenses,
    load_record,
    save_record,
)
from metafab.exposure.results import Correction
from metafab.layout import Lattice, PillarMap
from metafab.layout.outlines import Outline
from tests.physics.exposure.conftest import BEAM, disc, pattern


def test_correction_prints_what_is_drawn(lens: PillarMap) -> None:
    """Half a nanometre is asked; 64 classes leave a tenth of it."""
    plain = expose(lens, BEAM, numerics=ExposureNumerics(samples=5))
    corrected = expose(lens, BEAM, correction="dose", numerics=ExposureNumerics(samples=5))
    assert abs(plain.figures.cd_bias_nm) < 0.05
    assert plain.figures.cd_error_rms_nm > 0.3
    assert corrected.figures.cd_error_rms_nm < 0.1
    assert corrected.figures.cd_error_max_nm < 0.5
    assert corrected.figures.error < 8e-4
    assert corrected.figures.unprinted == 0
    # Where many neighbours expose a pillar, it needs less.
    middle, rim = corrected.dose[350, 350], corrected.dose[350, 3]
    assert rim > 1.03 * middle


def test_printed_edge_lies_where_the_energy_is_the_clearing_energy(lens: PillarMap) -> None:
    """Direct sum with the pillar itself drawn at its printed size crosses the threshold at the printed edge."""
    result = expose(lens, BEAM, numerics=ExposureNumerics(samples=4))
    ratio = result.figures.base_over_clearing_dose
    for pillar in result.samples:
        shift = 0.5 * (pillar.printed_width_nm - pillar.width_nm)
        # The slope of a Gaussian edge of range 8 nm and the power law's share beside it.
        own = 0.55 * 0.5 * (erf((pillar.width_nm + shift) / 8.0) - erf(shift / 8.0))
        at_edge = 0.55 * 0.5 * erf(pillar.width_nm / 8.0)
        predicted = pillar.energy_edge_x + ratio * pillar.dose * (own - at_edge)
        assert predicted == pytest.approx(1.0, abs=0.01)


def test_walls_of_a_lone_pillar_by_contrast() -> None:
    """At the edge of a wide pillar the energy is erfc(s / range) / 2; at twice the clearing dose s = 0 halfway up."""
    beam, index = BeamPsf.of([BeamTerm("gauss", 1.0, 20.0)], "assumption"), np.zeros((5, 5))
    index[2, 2] = 1
    lone = pattern(np.array([(300.0, 300.0)]), index)
    figures = expose(lone, beam, base_over_clearing_dose=2.0, contrast=4.0).figures
    assert figures.walls is not None
    for found, factor in ((figures.walls.foot_bias_nm, 10.0**-0.125), (figures.walls.top_bias_nm, 10.0**0.125)):
        assert found == pytest.approx(2.0 * 20.0 * erfcinv(factor), abs=0.02)
    assert (figures.cd_bias_nm, figures.walls.low_share) == (pytest.approx(0.0, abs=1e-3), 0.0)
    assert expose(lone, beam, base_over_clearing_dose=2.0).figures.walls is None


def test_pillars_are_listed_once_each_and_as_many_as_there_are() -> None:
    """Three pillars on a lattice of two million sites: each is listed, and drawing them ends."""
    index = np.zeros((1500, 1500), dtype=np.uint16)
    index[3, 7] = index[700, 1400] = index[1499, 0] = 1
    result = expose(pattern(np.array([(150.0, 200.0)]), index), BEAM, numerics=ExposureNumerics(samples=10))
    assert result.figures.pillars == 3
    assert len({(pillar.x_um, pillar.y_um) for pillar in result.samples}) == len(result.samples) == 3


@pytest.mark.parametrize("correction", ["dose", "shape"])
def test_discs_on_a_hexagonal_lattice_print_at_size(correction: Correction) -> None:
    """Doses leave the difference of both diameters, the lattice being no square; shapes a step of 1 nm."""
    lattice = Lattice(period_dbu=(380, 658), shape=(31, 53), database_unit_nm=0.5, hexagonal=True)
    index = np.random.default_rng(8).integers(1, 9, lattice.shape)
    index[~lattice.carries(np.arange(31), np.arange(53))] = 0
    sizes = np.repeat([[0], *((4 * side,) for side in range(55, 127, 9))], 2, axis=1).astype(np.int32)
    pillars = PillarMap.from_array(lattice, sizes, index.astype(np.uint16), 512)
    found = [
        expose(pillars, BEAM.blurred(20.0), outline=Outline("ellipse", 0.5), correction=kind).figures
        for kind in ("none", correction)
    ]
    assert found[0].cd_error_rms_nm > 3.0 * found[1].cd_error_rms_nm
    assert found[1].cd_error_rms_nm < (0.1 if correction == "dose" else 0.5)
    assert np.isnan(found[1].corner_radius_nm)


def test_corrected_shapes_print_what_was_drawn() -> None:
    """One Gaussian of 60 nm, where no dose serves width and length: shapes on a grid of 1 nm end within a step.

    The error is uniform within half a step, 0.29 nm rms, times the enlargement of a step by the neighbours.
    """
    rng = np.random.default_rng(5)
    lens = pattern(2.0 * rng.integers(55, 115, (40, 2)), disc(60, 40, seed=6))
    beam = BeamPsf.of([BeamTerm("gauss", 1.0, 60.0)], "assumption")
    plain, dosed, shaped = (
        expose(lens, beam, base_over_clearing_dose=2.0, correction=kind).figures for kind in ("none", "dose", "shape")
    )
    assert plain.cd_error_rms_nm > dosed.cd_error_rms_nm > 3.0
    assert shaped.cd_error_rms_nm < 0.5
    assert shaped.cd_error_max_nm < 1.5
    assert (shaped.dose_min, shaped.dose_max, shaped.unprinted) == (1.0, 1.0, 0)


def test_maps_window_and_kept_sizes(lens: PillarMap) -> None:
    """The map's mean is the bias; the window passes through the errors at the base dose; sizes are those listed."""
    result = expose(lens, BEAM, numerics=ExposureNumerics(samples=20, keep_sizes=True))
    figures, bias_nm = result.figures, result.size_map.bias_nm
    assert np.nanmean(bias_nm) == pytest.approx(figures.cd_bias_nm, abs=0.1)
    assert np.isnan(bias_nm[0, 0])
    percent = [point.dose_change_percent for point in result.window]
    assert percent == sorted(percent)
    by_change = {point.dose_change_percent: point for point in result.window}
    assert by_change[0.0].rms_nm == pytest.approx(figures.cd_error_rms_nm, rel=0.05)
    slope = (by_change[2.0].bias_nm - by_change[-2.0].bias_nm) / 4.0
    assert slope == pytest.approx(figures.latitude_nm_per_percent, rel=0.1)
    kept = result.printed_less_drawn_nm
    assert kept is not None
    for pillar in result.samples:
        column = round((1e3 * pillar.x_um - 1e3 * lens.lattice.x_um()[0]) / 350.0)
        row = round((1e3 * pillar.y_um - 1e3 * lens.lattice.y_um()[0]) / 350.0)
        found = np.array([pillar.printed_width_nm - pillar.width_nm, pillar.printed_length_nm - pillar.length_nm])
        np.testing.assert_allclose(kept[:, row, column], found, atol=1e-3)


def test_lenses_beside_one_another_are_corrected_together() -> None:
    """Two lenses 3 um apart at a blur of 20 nm: with the doses of one for both, the other prints 0.9 nm off at most.

    One dose for each pillar leaves the difference of its width and length, but no mean error.
    """
    pillars = pattern(2.0 * np.random.default_rng(5).integers(50, 115, (40, 2)), disc(60, 40, seed=6))
    beam, apart_nm = BEAM.blurred(20.0), 60 * 350.0 + 3000.0
    others = [OtherLens(pillars, (side * apart_nm, 0.0), number=3 - number) for number, side in ((1, 1), (2, -1))]
    lenses = [ExposedLens(pillars, Beside((other,)), number=3 - other.number) for other in others]
    continuous = ExposureNumerics(classes=0, keep_sizes=True)
    lone = expose_lenses(lenses[:1], beam, correction="dose", numerics=continuous)[0]
    for order in (lenses, lenses[::-1]):
        first, second = expose_lenses(order, beam, correction="dose", numerics=continuous)
        assert first.printed_less_drawn_nm is not None
        assert np.abs(first.printed_less_drawn_nm.mean(axis=0)).max() < 0.01
        assert first.figures.cd_error_rms_nm == pytest.approx(second.figures.cd_error_rms_nm, rel=0.05)
    assert np.abs(first.dose - lone.dose).max() > 0.02
    for found in expose_lenses(lenses, beam, correction="dose", numerics=ExposureNumerics(classes="auto")):
        assert 2 < found.figures.classes == len(found.class_dose) < 40
        assert found.figures.continuous_rms_nm is not None
        rounding_nm = np.sqrt(found.figures.cd_error_rms_nm**2 - found.figures.continuous_rms_nm**2)
        # Uniform within 0.1 nm to both sides.
        assert rounding_nm == pytest.approx(0.1 / np.sqrt(3.0), rel=0.3)


def test_shapes_of_several_lenses_are_refused(lens: PillarMap) -> None:
    with pytest.raises(InputError, match=r"one lens, whose shapes are corrected.*got 2.*correct each alone"):
        expose_lenses([ExposedLens(lens), ExposedLens(lens, number=2)], BEAM, correction="shape")


@pytest.fixture(scope="module")
def record() -> ExposureRecord:
    lens = pattern(np.array([(150.0, 200.0), (120.0, 180.0)]), disc(90, 2))
    plain, corrected = (SizeErrors.of(expose(lens, BEAM, correction=kind)) for kind in ("none", "dose"))
    return ExposureRecord("abc", "assumption", "dose", plain, corrected)


def test_a_record_survives_its_file(record: ExposureRecord, tmp_path: Path) -> None:
    save_record(record, tmp_path / "exposure.json")
    loaded = load_record(tmp_path / "exposure.json")
    assert loaded is not None and loaded.corrected is not None
    assert (loaded.mask_sha256, loaded.correction) == ("abc", "dose")
    assert loaded.plain.figures == record.plain.figures
    assert loaded.plain.window == record.plain.window
    assert loaded.plain.size_map.block_um == record.plain.size_map.block_um
    np.testing.assert_array_equal(loaded.plain.size_map.bias_nm, record.plain.size_map.bias_nm)
    assert np.isnan(loaded.plain.size_map.bias_nm[0, 0]), "no pillar stands in the corner"
    np.testing.assert_array_equal(loaded.corrected.cd_histogram, record.corrected.cd_histogram)
    # Two sides of each printed pillar.
    assert loaded.corrected.cd_histogram.sum() == 2 * loaded.corrected.figures.pillars


@pytest.mark.parametrize(
    ("key", "value"),
    [("cd_histogram", [1.0, 2.0]), ("size_map", {"bias_nm": [1.0], "block_um": [1.0, 1.0]}), ("window", [])],
)
def test_damaged_records_are_refused_whole(key: str, value: object, record: ExposureRecord, tmp_path: Path) -> None:
    path = tmp_path / "exposure.json"
    save_record(record, path)
    table = json.loads(path.read_text(encoding="utf-8"))
    table["plain"][key] = value
    path.write_text(json.dumps(table), encoding="utf-8")
    assert load_record(path) is None
    path.write_text("{", encoding="utf-8")
    assert load_record(path) is None
    assert load_record(tmp_path / "missing.json") is None


def test_where_nothing_prints_there_are_no_sizes() -> None:
    """Sizes off by 0.0 nm were stated of pillars that are not there, and doses were corrected in vain."""
    lens = pattern(np.array([(150.0, 200.0), (120.0, 180.0)]), disc(90, 2))
    figures = expose(lens, BEAM, base_over_clearing_dose=0.05).figures
    assert figures.unprinted == figures.pillars
    sizes = (figures.cd_error_rms_nm, figures.cd_error_max_nm, figures.cd_bias_nm, figures.latitude_nm_per_percent)
    assert np.isnan(sizes).all()
    with pytest.raises(InputError, match="no pillar prints"):
        expose(lens, BEAM, base_over_clearing_dose=0.05, correction="dose")
