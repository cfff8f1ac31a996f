"""Other people's sweeps: every form of file gives the same library, and its error covers what interpolation misses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from metafab import library
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.errors import InputError
from metafab.library.foreign.imported import import_sweep
from metafab.spec import UnitCell, make_unit_cell

STEP_NM = 10.0
SIZES_NM = np.arange(100.0, 250.1, STEP_NM)
#: sqrt(n_in / n_out) of the cell: from the substrate to air.
RATIO = np.sqrt(1.5)


def _t(width_nm: FloatArray, length_nm: FloatArray) -> ComplexArray:
    """A smooth amplitude of two turns of phase with a broad dip."""
    u, v = (width_nm - 100.0) / 150.0, (length_nm - 100.0) / 150.0
    dip = 1.0 - 0.5 / (1.0 + 40.0 * (u + 0.5 * v - 0.8) ** 2)
    return np.asarray(0.9 * dip * np.exp(1j * (7.0 * u + 3.0 * v + u * v)))


@pytest.fixture
def cell() -> UnitCell:
    return make_unit_cell(
        period_nm=350, height_nm=600, pillar=3.0, substrate=1.5, wavelength_nm=800, sizes_nm=(100, 250), size_grid_nm=5
    )


@pytest.fixture
def samples() -> tuple[FloatArray, FloatArray, ComplexArray, ComplexArray]:
    """Shuffled sizes without a tenth of those inside."""
    width, length = (axis.ravel() for axis in np.meshgrid(SIZES_NM, SIZES_NM))
    rng = np.random.default_rng(2)
    inside = (width > 100.0) & (width < 250.0) & (length > 100.0) & (length < 250.0)
    kept = rng.permutation(np.flatnonzero(~inside | (rng.random(width.size) > 0.1)))
    width, length = width[kept], length[kept]
    return width, length, _t(width, length), _t(length, width)


def _rows(path: Path, header: str, *columns: FloatArray) -> Path:
    np.savetxt(path, np.stack(columns, axis=1), delimiter=",", header=header, comments="", fmt="%.15g")
    return path


def _both(path: Path, width: FloatArray, length: FloatArray) -> Path:
    """File of both polarisations at sizes of any order."""
    header, (x, y) = "width_nm,length_nm,t_xx_re,t_xx_im,t_yy_re,t_yy_im", (_t(width, length), _t(length, width))
    return _rows(path, header, width, length, x.real, x.imag, y.real, y.imag)


Writer = Callable[[Path, FloatArray, FloatArray, ComplexArray, ComplexArray], tuple[Path, str, str]]


def _parts(folder: Path, w: FloatArray, h: FloatArray, x: ComplexArray, y: ComplexArray) -> tuple[Path, str, str]:
    header = "width_nm,length_nm,t_xx_re,t_xx_im,t_yy_re,t_yy_im"
    return _rows(folder / "a.csv", header, w, h, x.real, x.imag, y.real, y.imag), "field", "minus"


def _phases(folder: Path, w: FloatArray, h: FloatArray, x: ComplexArray, y: ComplexArray) -> tuple[Path, str, str]:
    header = "length_um,width_um,t_xx_abs,t_xx_phase_deg,t_yy_abs,t_yy_phase_deg"
    moduli = [np.abs(t / RATIO) ** 2 for t in (x, y)]
    turns = [np.degrees(np.angle(t)) for t in (x, y)]
    path = _rows(folder / "b.csv", header, h / 1e3, w / 1e3, moduli[0], turns[0], moduli[1], turns[1])
    return path, "power", "minus"


def _scattering(folder: Path, w: FloatArray, h: FloatArray, x: ComplexArray, y: ComplexArray) -> tuple[Path, str, str]:
    """Metres, and the engineers' exp(+i omega t)."""
    np.savez(folder / "c.npz", width_m=1e-9 * w, length_m=1e-9 * h, t_xx=(x / RATIO).conj(), t_yy=(y / RATIO).conj())
    return folder / "c.npz", "s21", "plus"


def _alike(folder: Path, w: FloatArray, h: FloatArray, x: ComplexArray, y: ComplexArray) -> tuple[Path, str, str]:
    """Both polarisations of a map in HDF5, with NaN where a size is missing."""
    maps = np.full((2, SIZES_NM.size, SIZES_NM.size), np.nan, dtype=np.complex128)
    place = ((h - 100.0) / STEP_NM).astype(int), ((w - 100.0) / STEP_NM).astype(int)
    maps[0][place], maps[1][place] = x, y
    with h5py.File(folder / "d.h5", "w") as file:
        file["width_nm"], file["length_nm"], file["t_xx"], file["t_yy"] = SIZES_NM, SIZES_NM, maps[0], maps[1]
    return folder / "d.h5", "field", "minus"


def _matlab(folder: Path, w: FloatArray, h: FloatArray, x: ComplexArray, y: ComplexArray) -> tuple[Path, str, str]:
    """A matrix of MATLAB's version 7.3, a row for each length: transposed, its parts in a record."""
    maps = np.full((2, SIZES_NM.size, SIZES_NM.size), np.nan, dtype=np.complex128)
    place = ((h - 100.0) / STEP_NM).astype(int), ((w - 100.0) / STEP_NM).astype(int)
    maps[0][place], maps[1][place] = x, y
    with h5py.File(folder / "e.h5", "w") as file:
        for name in ("width_nm", "length_nm"):
            file[name] = SIZES_NM[:, None]
        for name, values in (("t_xx", maps[0]), ("t_yy", maps[1])):
            record = np.zeros(values.shape, dtype=[("real", "f8"), ("imag", "f8")])
            record["real"], record["imag"] = values.T.real, values.T.imag
            file[name] = record
        for item in file.values():
            item.attrs["MATLAB_class"] = np.bytes_("double")
    return folder / "e.h5", "field", "minus"


@pytest.mark.parametrize("write", [_parts, _phases, _scattering, _alike, _matlab])
def test_every_form_of_file_gives_the_same_library(
    write: Writer, cell: UnitCell, samples: tuple[FloatArray, FloatArray, ComplexArray, ComplexArray], tmp_path: Path
) -> None:
    path, quantity, time_sign = write(tmp_path, *samples)
    found = import_sweep(path, cell, quantity=quantity, time_sign=time_sign)  # type: ignore[arg-type]
    assert found.unit_cell.sweep.width_nm == (100.0, 250.0)
    assert found.t_xx.shape == (1, 31, 31)
    width, length = np.meshgrid(found.width_nm, found.length_nm)
    for t, true in ((found.t_xx[0], _t(width, length)), (found.t_yy[0], _t(length, width))):
        missed = np.abs(t - true)
        assert (missed <= found.error_of_sizes).mean() > 0.99
        assert missed.max() < 0.02
    given = found.at_sizes(samples[0], samples[1])
    assert given.t_xx == pytest.approx(samples[2], abs=1e-9)
    # Cross-validation, with fewer samples, errs more than the library, but not by orders of magnitude.
    assert 1e-4 < np.median(found.error_of_sizes) < 2e-2
    assert found.statistics.held_out == samples[0].size
    assert found.statistics.is_imported
    assert found.surface(173.2, 181.7).t_xx == pytest.approx(_t(np.float64(173.2), np.float64(181.7)), abs=2e-3)
    library.save(found, tmp_path / "lib.h5")
    assert np.array_equal(library.load(tmp_path / "lib.h5").t_xx, found.t_xx)
    assert library.quality(found).coverage_rad > 3.0


def test_diameters_make_a_library_of_circles(cell: UnitCell, tmp_path: Path) -> None:
    diameter = np.arange(100.0, 250.1, 6.0)
    t = _t(diameter, diameter)
    path = _rows(tmp_path / "circles.csv", "diameter_nm,t_re,t_im", diameter, t.real, t.imag)
    found = import_sweep(path, replace(cell, cell=replace(cell.cell, shape="circle")), quantity="field")
    assert found.known.sum() == 31
    sides = _rows(tmp_path / "sides.csv", "width_nm,length_nm,t_re,t_im", diameter, diameter, t.real, t.imag)
    same = import_sweep(sides, replace(cell, cell=replace(cell.cell, shape="circle")), quantity="field")
    assert np.array_equal(same.t_xx, found.t_xx, equal_nan=True)
    on_grid = found.t_xx[0].diagonal()
    assert on_grid == pytest.approx(_t(found.width_nm, found.width_nm), abs=5e-3)
    assert np.array_equal(on_grid, found.t_yy[0].diagonal())
    # In a hexagonal lattice, too, one amplitude serves both polarisations.
    geometry = replace(cell.cell, shape="ring", wall_nm=20.0, lattice="hexagonal", period_nm=(350.0, 303.0))
    rings = import_sweep(path, replace(cell, cell=geometry), quantity="field")
    assert np.array_equal(rings.t_yy[0].diagonal(), on_grid)


def test_sizes_outside_the_samples_stay_unknown(cell: UnitCell, tmp_path: Path) -> None:
    width, length = (axis.ravel() for axis in np.meshgrid(SIZES_NM, SIZES_NM))
    kept = width + length < 420.0
    width, length = width[kept], length[kept]
    t = _t(width, length)
    t[0] = np.nan  # The solver did not converge there.
    path = _rows(tmp_path / "corner.csv", "width_nm,length_nm,t_re,t_im", width, length, t.real, t.imag)
    found = import_sweep(path, cell, quantity="field")
    assert found.statistics.points_left_out == 1
    assert not found.known[-1, -1]
    assert np.isnan(found.t_xx[0, -1, -1])
    with pytest.raises(InputError):
        found.at_sizes(250.0, 250.0)


@pytest.mark.parametrize(
    ("header", "scale", "message"),
    [
        ("width_nm,length_nm,t_xx_re,t_xx_im", 1.0, r"expected amplitudes of both polarisations"),
        ("width_nm,length_nm,amplitude,phase", 1.0, r"expected an amplitude `t`"),
        ("w,l,t_re,t_im", 1.0, r"expected `width_nm` and `length_nm`"),
        ("width_um,length_um,t_re,t_im", 1.0, r"is the unit right\?"),
        ("width_nm,length_nm,t_re,t_im", 1.6, r"expected at most 1, got 1\.\d+ at .*another `quantity`"),
        ("width_nm,length_nm,t_re,t_abs", 1.0, r"expected `t_re` and `t_im`, or `t_abs`"),
        (
            "width_nm,length_nm,t_abs,t_phase_rad",
            0.99,
            r"better than their mean.*error of \d.* in the unit of its column",
        ),
    ],
)
def test_what_does_not_fit_is_refused(header: str, scale: float, message: str, cell: UnitCell, tmp_path: Path) -> None:
    # One amplitude serves both polarisations only where every size is there in both orientations.
    width, length = (axis.ravel() for axis in np.meshgrid(SIZES_NM if scale == 1.0 else SIZES_NM[:8], SIZES_NM[:8]))
    t = scale * _t(width, length)
    parts = (np.abs(t), 15.0 * np.angle(t)) if header.endswith("_rad") else (t.real, t.imag)
    path = _rows(tmp_path / "sweep.csv", header, width, length, *parts)
    with pytest.raises(InputError, match=message):
        import_sweep(path, cell, quantity="field")


def test_decibels_in_a_column_of_moduli_are_refused(cell: UnitCell, tmp_path: Path) -> None:
    width, length = (axis.ravel() for axis in np.meshgrid(SIZES_NM, SIZES_NM))
    t = _t(width, length)
    decibels = 20.0 * np.log10(np.abs(t))
    path = _rows(tmp_path / "sweep.csv", "width_nm,length_nm,t_abs,t_phase_rad", width, length, decibels, np.angle(t))
    with pytest.raises(InputError, match=r"`t_abs`: expected moduli of 0 or more, got -.*decibels"):
        import_sweep(path, cell, quantity="s21")


def test_degrees_in_a_column_of_radians_are_refused_at_the_sizes_of_the_file_too(
    cell: UnitCell, tmp_path: Path
) -> None:
    width, length = (axis.ravel() for axis in np.meshgrid(SIZES_NM[:8], SIZES_NM[:8]))
    t = _t(width, length)
    own = replace(cell, sweep=replace(cell.sweep, size_grid_nm=float(SIZES_NM[1] - SIZES_NM[0])))
    for unit, phase in (("rad", np.angle(t)), ("deg", np.degrees(np.angle(t)))):
        header = f"width_nm,length_nm,t_abs,t_phase_{unit}"
        path = _rows(tmp_path / f"{unit}.csv", header, width, length, np.abs(t), phase)
        import_sweep(path, own, quantity="field")
    path = _rows(tmp_path / "sweep.csv", "width_nm,length_nm,t_abs,t_phase_rad", width, length, np.abs(t), phase)
    with pytest.raises(InputError, match=r"`t_phase_rad`: expected radians.*`t_phase_deg`"):
        import_sweep(path, own, quantity="field")


def test_widths_and_lengths_of_unlike_shapes_are_refused(cell: UnitCell, tmp_path: Path) -> None:
    width_nm, length_nm = SIZES_NM[:, None], SIZES_NM[:9, None]  # columns, as a matrix program keeps them
    np.savez(tmp_path / "sweep.npz", width_nm=width_nm, length_nm=length_nm, t=_t(SIZES_NM, SIZES_NM[:9, None]))
    with pytest.raises(
        InputError, match=r"`sizes`: expected .* got `width` of shape \(16, 1\), `length` of shape \(9, 1\)"
    ):
        import_sweep(tmp_path / "sweep.npz", cell, quantity="field")


@pytest.mark.parametrize("line", ["width", "length", "squares", "oblique"])
def test_sizes_on_one_line_serve_along_it(cell: UnitCell, tmp_path: Path, line: str) -> None:
    fixed = np.full_like(SIZES_NM, 150.0)
    width = fixed if line == "length" else SIZES_NM
    length = {"width": fixed, "oblique": SIZES_NM + 30.0}.get(line, SIZES_NM)
    found = import_sweep(_both(tmp_path / "line.csv", width, length), cell, quantity="field")
    own = found.at_sizes(width, length)
    assert own.t_xx == pytest.approx(_t(width, length), abs=1e-12)
    assert own.error.max() < 1e-8
    row, column = np.nonzero(found.known)
    assert row.size == 2 * SIZES_NM.size - 1
    missed = np.abs(found.t_xx[0] - _t(found.width_nm[None, :], found.length_nm[:, None]))[row, column]
    assert (missed <= found.error_of_sizes[row, column]).mean() > 0.9


def test_one_size_beside_a_line_of_sizes_serves_as_well(cell: UnitCell, tmp_path: Path) -> None:
    width, length = np.append(SIZES_NM, 200.0), np.append(np.full_like(SIZES_NM, 150.0), 160.0)
    found = import_sweep(_both(tmp_path / "beside.csv", width, length), cell, quantity="field")
    assert found.at_sizes(width, length).t_yy == pytest.approx(_t(length, width), abs=1e-12)


def test_a_sweep_of_wide_steps_along_one_side_states_its_error_there(cell: UnitCell, tmp_path: Path) -> None:
    """A size left out alone is predicted by its neighbours 2 nm away; between the lengths there are none."""
    width, length = (axis.ravel() for axis in np.meshgrid(np.arange(100.0, 250.1, 2.0), np.arange(100.0, 250.1, 25.0)))
    found = import_sweep(_both(tmp_path / "wide.csv", width, length), cell, quantity="field")
    at = found.width_nm[None, :], found.length_nm[:, None]
    missed = np.maximum(np.abs(found.t_xx[0] - _t(*at)), np.abs(found.t_yy[0] - _t(*at[::-1])))
    assert missed.max() > 0.05
    assert (missed <= found.error_of_sizes).mean() > 0.98


def test_a_size_given_twice_is_refused(cell: UnitCell, tmp_path: Path) -> None:
    width = np.repeat(SIZES_NM, 2)
    path = _rows(tmp_path / "twice.csv", "width_nm,length_nm,t_re,t_im", width, width, width / 999.0, 0.0 * width)
    with pytest.raises(InputError, match="more than once"):
        import_sweep(path, cell, quantity="field")


def test_a_coarse_sweep_serves_at_its_own_sizes_alone(cell: UnitCell, tmp_path: Path) -> None:
    """Circles a third of a turn apart: each is predicted from neighbours two thirds apart, which tell nothing."""
    diameter = np.arange(100.0, 251.0, 15.0)
    t = 0.9 * np.exp(2j / 3 * np.pi * np.arange(diameter.size))
    path = _rows(tmp_path / "levels.csv", "diameter_nm,t_re,t_im", diameter, t.real, t.imag)
    circles = replace(cell, cell=replace(cell.cell, shape="circle"))
    own = replace(circles, sweep=replace(circles.sweep, size_grid_nm=15.0))
    found = import_sweep(path, own, quantity="field")
    assert found.t_xx[0].diagonal() == pytest.approx(t, abs=1e-9)
    assert found.statistics.held_out_error > 0.5
    assert found.statistics.max_error < 1e-8
    assert found.statistics.sizes_beyond_target == 0
    with pytest.raises(InputError, match="sizes between"):
        import_sweep(path, circles, quantity="field")
    # Less steep, it serves between its sizes as well, with the error that it states.
    t = 0.9 * np.exp(1.75j * np.arange(diameter.size))
    _rows(path, "diameter_nm,t_re,t_im", diameter, t.real, t.imag)
    between = import_sweep(path, circles, quantity="field")
    assert 0.5 < np.nanmedian(between.error_of_sizes) < 2.0
    own_sizes = np.isin(between.width_nm, diameter)
    assert between.error_of_sizes.diagonal()[own_sizes].max() < 1e-8


def test_a_transmittance_is_no_amplitude(cell: UnitCell, tmp_path: Path) -> None:
    """The letter T: beside an amplitude it is left out; in its place, or as a real `t`, it would have no phase."""
    circles = replace(cell, cell=replace(cell.cell, shape="circle"))
    t = _t(SIZES_NM, SIZES_NM)
    power = np.abs(t / RATIO) ** 2
    path = _rows(tmp_path / "a.csv", "diameter_nm,t_re,t_im,T", SIZES_NM, t.real, t.imag, power)
    assert abs(import_sweep(path, circles, quantity="field").t_xx[0, 0, 0] - t[0]) < 1e-9
    for header, message in (
        ("diameter_nm,T,phase", "columns`: expected an amplitude `t`, .*got the columns diameter_nm, T, phase"),
        ("diameter_nm,t,phase", "t`: expected complex numbers, .*got real ones, which have no phase; name its parts"),
    ):
        path = _rows(tmp_path / "b.csv", header, SIZES_NM, power, np.angle(t))
        with pytest.raises(InputError, match=message):
            import_sweep(path, circles, quantity="power")
