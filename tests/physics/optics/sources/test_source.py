"""PSFs of a hexagonal lattice: against the direct sum over its sites, and beside a square lattice's."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.special import j1

from benchmarks.optics.direct_sum import direct_irradiance
from metafab.core.errors import InputError
from metafab.layout.pillars import Lattice, PillarMap
from metafab.library import Library
from metafab.optics import Apodisation, Imaging, PsfNumerics, apodised, ideal_field, psf, relative_l2
from metafab.optics.sources.source import IdealField, written_field
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Design, Device, load_design
from metafab.spec.device import Optics
from metafab.steps.job import Job
from metafab.steps.optics import ideal_source, lit_source
from tests import optics_lens as lens
from tests.main_job import ROOT

OPTICS = lens.imaging(aperture_um=40.0)
WINDOW_PX = 20
#: A slow lens without a split: paraxial to 2e-4.
SLOW = Imaging(
    wavelength_um=0.8,
    focal_length_mm=2.5,
    split_angle_deg=0.0,
    sensor_distance_um=2500.0,
    pixel_um=4.0,
    aperture_um=100.0,
)
FOCUS_UM = 2500.0


@pytest.fixture(scope="module")
def hexagonal() -> IdealField:
    """Period 350 nm, rows 303 nm apart."""
    device = Device(
        aperture_um=OPTICS.aperture_um, focal_length_mm=OPTICS.focal_length_mm, aperture_shape=OPTICS.aperture_shape
    )
    profile = PhaseProfile((lens.eq_3_and_4(OPTICS),))  # type: ignore[arg-type]
    return ideal_field(
        profile, Lattice(period_dbu=(350, 606), shape=(133, 229), database_unit_nm=0.5, hexagonal=True), device
    )


def test_the_stated_error_bounds_the_true_one(hexagonal: IdealField) -> None:
    result = psf(hexagonal, OPTICS, [0.8e-3], PsfNumerics(window_px=WINDOW_PX, target_error=1e-3))
    for polarisation in (0, 1):
        points = lens.window_points(OPTICS, result.centre_um[polarisation, 0], WINDOW_PX)
        true = direct_irradiance(hexagonal, OPTICS, 0.8e-3, (0.0, 0.0), *points, polarisation)
        assert relative_l2(result.psf[polarisation, 0].ravel(), true) <= result.error[0] <= 1.5e-3


def test_the_lattice_does_not_matter_to_a_lens_of_full_transmission(hexagonal: IdealField) -> None:
    """Either lattice samples the same phases, and a pillar stands for its cell: absolute irradiance agrees but for the
    rim, where a cell belongs to the lens or not: 2 pi R times half a period is 2 % of the area, and random."""
    square = psf(
        lens.ideal(OPTICS, lens.eq_3_and_4(OPTICS)),
        OPTICS,
        [0.8e-3],
        PsfNumerics(window_px=WINDOW_PX, target_error=1e-3),
    )
    other = psf(hexagonal, OPTICS, [0.8e-3], PsfNumerics(window_px=WINDOW_PX, target_error=1e-3))
    assert other.psf.max() == pytest.approx(square.psf.max(), rel=0.01)
    assert other.efficiency[:, 0] == pytest.approx(square.efficiency[:, 0], rel=0.01)


def _plain_lens() -> IdealField:
    return lens.ideal(SLOW, lambda x, y, p: -SLOW.wavenumber * (np.hypot(np.hypot(x, y[:, None]), FOCUS_UM) - FOCUS_UM))


def test_a_stop_gives_its_own_airy_pattern() -> None:
    """(pi S^2)^2 / (pi R^2) / (lambda f)^2 [2 J1(v) / v]^2 of a stop of radius S before a lens of radius R.

    As without a stop, the ragged rim of whole sites takes 1e-3 of the shape; its area is counted.
    """
    stopped = apodised(_plain_lens(), Apodisation(stop_um=60.0))
    result = psf(stopped, SLOW, [math.inf], PsfNumerics(window_px=32, target_error=1e-4))
    x, y = lens.window_points(SLOW, np.zeros(2), 32)
    v = np.maximum(SLOW.wavenumber * 30.0 * np.hypot(x, y) / FOCUS_UM, 1e-9)
    area = sum(np.count_nonzero(tile.amplitude(0)) for tile in stopped.tiles()) * 0.35**2
    assert area == pytest.approx(math.pi * 30.0**2, rel=2e-3)
    airy = area**2 / (math.pi * 50.0**2) / (0.8 * FOCUS_UM) ** 2 * (2.0 * j1(v) / v) ** 2
    for p in (0, 1):
        assert relative_l2(result.psf[p, 0].ravel(), airy) < 1.5e-3
        assert result.details.transmitted[p] == pytest.approx(0.36, rel=2e-3)


def test_a_gaussian_amplitude_gives_a_gaussian_spot() -> None:
    """exp(-r^2 / w^2) over a much wider lens: irradiance (pi w^2 / l f)^2 exp(-2 (pi w rho / l f)^2) / pi R^2.

    The samples' lines are straight between points 1 um apart: (1 um / w)^2 / 8 of the amplitude, 4e-4.
    """
    waist = 18.0
    at = np.arange(101) - 50.0
    samples = np.exp(-(at[:, None] ** 2 + at[None, :] ** 2) / waist**2)
    result = psf(
        apodised(_plain_lens(), Apodisation(samples=samples, pitch_um=1.0)), SLOW, [math.inf], PsfNumerics(window_px=32)
    )
    x, y = lens.window_points(SLOW, np.zeros(2), 32)
    scale = math.pi * waist / (0.8 * FOCUS_UM)
    spot = (scale * waist) ** 2 * np.exp(-2.0 * scale**2 * (x**2 + y**2)) / (math.pi * 50.0**2)
    assert relative_l2(result.psf[0, 0].ravel(), spot) < 3e-3
    power = 0.5 * math.pi * waist**2 / (math.pi * 50.0**2)
    assert result.details.transmitted[0] == pytest.approx(power, rel=3e-3)


def test_psfs_of_pillars_behind_stop_and_amplitude_keep_the_stated_error() -> None:
    """Tiles of indices become amplitudes where they are weakened, and go where they are dark."""
    optics = lens.imaging(aperture_um=40.0)
    ramp = np.linspace(0.2, 1.0, 30)[None, :] * np.ones((30, 1))
    source = apodised(
        lens.written(optics, lens.eq_2(optics), lens.eq_3_and_4(optics)), Apodisation(25.0, ramp, pitch_um=1.4)
    )
    result = psf(source, optics, [0.9e-3], PsfNumerics(window_px=24, target_error=1e-3), tangent=(0.05, 0.02))
    for p in (0, 1):
        points = lens.window_points(optics, result.centre_um[p, 0], 24)
        true = direct_irradiance(source, optics, 0.9e-3, (0.05, 0.02), *points, p)
        assert relative_l2(result.psf[p, 0].ravel(), true) <= result.error[0] <= 1.5e-3


def test_an_amplitude_is_not_mirrored_or_turned() -> None:
    """0.5 at the right, 1 above, by [row, column] with the lowest y first."""
    samples = np.ones((3, 3))
    samples[1, 2], samples[2, 1], samples[0, 1] = 0.5, 0.25, 0.75
    filter_ = Apodisation(samples=samples, pitch_um=10.0)
    values = filter_(np.array([-10.0, 0.0, 10.0]), np.array([-10.0, 0.0, 10.0]))
    np.testing.assert_allclose(values, samples)
    assert filter_(np.array([5.0]), np.array([0.0]))[0, 0] == pytest.approx(0.75)


def test_clear_tiles_stay_as_they_are_and_dark_ones_go() -> None:
    optics = lens.imaging(aperture_um=60.0)
    source = lens.written(optics, lens.eq_3_and_4(optics), tile_sites=20)
    tiles = list(apodised(source, Apodisation(stop_um=20.0)).tiles())
    assert len(tiles) < len(list(source.tiles()))
    assert any(tile.size_index is not None for tile in tiles)
    assert any(tile.size_index is None for tile in tiles)
    assert apodised(source, None) is source


def _design(small_design: Design, **changes: object) -> Design:
    return replace(small_design, optics=Optics(**changes))


def test_a_design_says_what_stands_there(small_design: Design, tmp_path: Path) -> None:
    assert Apodisation.of(small_design) is None
    assert Apodisation.of(_design(small_design, substrate_um=430.0, filter_fwhm_nm=10.0)) is None
    with h5py.File(tmp_path / "filter.h5", "w") as file:
        file["share"] = np.full((8, 8), 0.5)
    half = _design(
        small_design, stop_um=100.0, amplitude_file=tmp_path / "filter.h5", amplitude_pitch_um=30.0,
        amplitude_dataset="share",
    )  # fmt: skip
    job = Job(replace(half, phase=half.phase[1:]), tmp_path)
    power = sum(float(np.sum(np.abs(tile.amplitude(0)) ** 2)) for tile in lit_source(job, ideal_source(job)).tiles())
    assert power * 0.35**2 == pytest.approx(0.25 * math.pi * 50.0**2, rel=3e-3)


@pytest.mark.parametrize(
    ("samples", "expected"),
    [
        (np.full((8, 8), 1.2), "1.2 to 1.2"),
        (np.full((8, 8), np.nan), "amplitudes from 0 to 1"),
        (np.full((2, 8, 8), 0.5), r"shape \(2, 8, 8\)"),
        (np.full((4, 8), 0.5), "reaches 60 um"),
    ],
)
def test_wrong_amplitudes_are_refused(small_design: Design, tmp_path: Path, samples: np.ndarray, expected: str) -> None:
    np.save(tmp_path / "filter.npy", samples)
    design = _design(small_design, amplitude_file=tmp_path / "filter.npy", amplitude_pitch_um=30.0)
    with pytest.raises(InputError, match=expected):
        Apodisation.of(design)


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ("stop_um = 300.0", "must be at most `device.aperture_um`"),
        ("substrate_um = 3e4", "20000"),
        ('amplitude_file = "filter.npy"', "given together"),
        ("amplitude_pitch_um = 2.0", "given together"),
        ("stop_mm = 0.1", "stop_mm"),
    ],
)
def test_a_design_file_with_impossible_optics_is_refused(tmp_path: Path, keys: str, expected: str) -> None:
    path = _file(tmp_path, keys)
    with pytest.raises(InputError, match=expected):
        load_design(path)


def test_a_design_file_names_its_amplitude_beside_itself(tmp_path: Path) -> None:
    design = load_design(_file(tmp_path, 'amplitude_file = "a/filter.npy"\namplitude_pitch_um = 2.0'))
    assert design.optics is not None
    assert design.optics.amplitude_file == (tmp_path / "a" / "filter.npy").resolve()


def _file(folder: Path, keys: str) -> Path:
    text = (ROOT / "layouts" / "helix_small.toml").read_text().replace("../unitcell_lib", str(ROOT / "unitcell_lib"))
    assert "[optics]" not in text
    path = folder / "design.toml"
    path.write_text(f"{text}\n[optics]\n{keys}\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("is_hexagonal", [False, True])
def test_a_library_of_another_period_is_refused(smooth_library: Library, is_hexagonal: bool) -> None:
    """Its amplitudes would be those of other pillars. The sites of a hexagonal lattice lie half a period apart."""
    cell = smooth_library.unit_cell.cell
    x_dbu, y_dbu = (350, 606) if is_hexagonal else (700, 700)
    lattice = Lattice(period_dbu=(x_dbu, y_dbu), shape=(3, 3), database_unit_nm=0.5, hexagonal=is_hexagonal)
    pillars = PillarMap.from_array(lattice, np.array([[0, 0], [240, 300]]), np.ones((3, 3), dtype=np.uint16), 3)
    for period_nm, is_own in (((350.0, 303.0 if is_hexagonal else 350.0), True), ((400.0, 346.0), False)):
        shape = replace(cell, lattice="hexagonal" if is_hexagonal else None, period_nm=period_nm)
        library = replace(smooth_library, unit_cell=replace(smooth_library.unit_cell, cell=shape))
        if is_own:
            assert written_field(pillars, library).table.shape == (2, 2)
        else:
            with pytest.raises(
                InputError, match=r"`period_nm`: expected that of the pillars, 350 x .* got 400 x 346 nm"
            ):
                written_field(pillars, library)
