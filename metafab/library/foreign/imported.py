"""A library from a sweep that another program solved.

The sizes of the file are samples of smooth functions; the library holds their values on the grid of the unit cell's
``size_grid_nm`` between them. Between samples, local polyharmonic splines (radial basis functions r^3 with a linear
polynomial) go through all of them. Their error is that of leaving samples out: each tenth of the samples is predicted
from the others, which are then sparser than all samples, so that the prediction errs more than the library does. Sizes
of the file have no such error.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator
from scipy.spatial import Delaunay, QhullError, cKDTree

from metafab.cell import is_square, pillar_cell
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.errors import InputError
from metafab.core.figures import BuildStatistics
from metafab.core.storage.files import file_sha256, fingerprint
from metafab.library.fit.size_grid import SizeGrid
from metafab.library.foreign.table import Quantity, SweepTable, read_sweep
from metafab.library.library import Library
from metafab.library.use.quality import coverage_rad
from metafab.spec import UnitCell

#: Fewest samples.
_FEWEST = 8
#: Parts of the cross-validation.
_PARTS = 10
#: Samples near a point that its spline uses.
_NEAR = 32
#: Samples whose errors bound that of a point between them.
_NEIGHBOURS = 6
#: Distance within which a size is that of a sample (nm), and the error there: the rounding of the spline.
_SAME_NM, _ROUNDING = 1e-3, 1e-9
#: Largest power transmittance: 1, with the error of a rough solver.
_MOST_POWER = 1.05
#: Median error of predicted samples up to which no sweep is refused. Silicon at 800 nm in steps of 15, 20, 25 and 30 nm
#: has 0.35, 0.49, 0.66 and 0.89, at a true error between them of 0.11, 0.20, 0.39 and 0.42.
_HARMLESS = 0.1


def import_sweep(
    path: Path, unit_cell: UnitCell, *, quantity: Quantity, time_sign: Literal["minus", "plus"] = "minus"
) -> Library:
    """Make a library of a sweep in a file, with ``error`` from cross-validation; reflection is unknown (NaN).

    Amplitudes and errors are NaN at sizes outside the hull of the samples.

    Args:
        path: .csv, .npz or .h5 (:mod:`metafab.library.foreign.table`).
        unit_cell: lattice, materials, wavelength and ``size_grid_nm`` of the sweep; the file gives the range of sizes.
        quantity: "field" for the ratio of the electric fields, "power" if the modulus is the power transmittance, "s21"
            for a scattering parameter that is normalised to power.
        time_sign: sign in exp(-+ i omega t) of the program; amplitudes of "plus" are conjugated.

    Raises:
        InputError: the file cannot be used, a shape does not fit, the amplitudes exceed the incident power, or sizes
            between the samples are asked for whose amplitudes the samples do not predict.
    """
    table = read_sweep(path)
    _require_sizes(table, unit_cell, path)
    size_nm, t = _samples(table, unit_cell, path, quantity, time_sign)
    cell, grid = _grid(unit_cell, size_nm, path)
    lines = size_nm[:, :1] if grid.diagonal else size_nm
    missed = _left_out_errors(lines, t)
    values, error, share_between = _on_grid(grid, lines, t, missed)
    median, spread = (float(np.median(each)) for each in (missed, np.abs(t - t.mean(axis=0)).max(axis=1)))
    if share_between > 0.5 and median > max(_HARMLESS, spread):
        expected = f"amplitudes that those of like sizes predict better than their mean does, to {spread:.2g} (median)"
        got = f"an error of {median:.2g}, and {100.0 * share_between:.3g} % of the grid's sizes between"
        remedy = "is the phase in the unit of its column's name? A coarse sweep needs its own step as `size_grid_nm`"
        raise InputError.single(str(path), "amplitudes", expected, got, remedy)
    shape = grid.shape
    t_xx, t_yy = values.T.reshape(2, 1, *shape)
    library = Library(
        unit_cell=cell,
        wavelength_nm=np.array([cell.illumination.wavelength_nm]),
        width_nm=grid.width_nm,
        length_nm=grid.length_nm,
        t_xx=t_xx,
        t_yy=t_yy,
        r_xx=np.full_like(t_xx, np.nan),
        r_yy=np.full_like(t_yy, np.nan),
        error=error.reshape(1, *shape),
        inputs_sha256=fingerprint(file_sha256(path), unit_cell, quantity, time_sign),
    )
    known = np.isfinite(error)
    statistics = BuildStatistics(
        points_solved=len(lines),
        points_total=int(known.sum()),
        points_left_out=table.left_out,
        max_error=float(error[known].max()),
        sizes_beyond_target=int(np.count_nonzero(error[known] > cell.sweep.target_error)),
        held_out_error=float(missed.max()),
        held_out=missed.size,
        coverage_rad=coverage_rad(library),
    )
    return replace(library, statistics=statistics)


def _require_sizes(table: SweepTable, unit_cell: UnitCell, path: Path) -> None:
    """Refuse sizes that are too few, not those of the shape, or beyond the period."""
    unit_cell.cell.require_sides(path, table.has_diameters)
    unit_cell.cell.require_diameters(path, table.size_nm)
    if len(table.t_xx) < _FEWEST:
        raise InputError.single(str(path), "rows", f"at least {_FEWEST} sizes", f"{len(table.t_xx)}", "sweep more")
    limits_nm = np.array(unit_cell.cell.period_nm)
    if (table.size_nm <= 0.0).any() or (table.size_nm > limits_nm).any():
        low, high = table.size_nm.min(), table.size_nm.max()
        expected = f"sizes above 0 and within the period of {limits_nm[0]:g} x {limits_nm[1]:g} nm"
        raise InputError.single(str(path), "sizes", expected, f"{low:g} to {high:g} nm", "is the unit right?")


def _samples(
    table: SweepTable, unit_cell: UnitCell, path: Path, quantity: Quantity, time_sign: str
) -> tuple[FloatArray, ComplexArray]:
    """Sizes, shape (n, 2), and the field ratios t_xx and t_yy there, shape (n, 2)."""
    cell = pillar_cell(unit_cell, 0.0, 0.0)
    ratio = np.array([np.sqrt(complex(a).real / complex(b).real) for a, b in zip(cell.n_in, cell.n_out, strict=True)])
    size_nm, t_xx, t_yy = table.size_nm, table.t_xx, table.t_yy
    if t_yy is None:
        size_nm, t_xx, t_yy = _exchanged(table, unit_cell, path)
    t = np.stack([t_xx, t_yy], axis=1)
    if quantity == "power":  # the modulus is a power
        t = np.sqrt(np.abs(t)) * np.exp(1j * np.angle(t))
    if quantity != "field":
        t = t * ratio
    power = (np.abs(t) / ratio) ** 2
    if power.max() > _MOST_POWER:
        worst = int(np.argmax(power.max(axis=1)))
        got = f"{power.max():.3g} at {size_nm[worst, 0]:g} x {size_nm[worst, 1]:g} nm, read as quantity {quantity!r}"
        remedy = "is it another `quantity`, or are the media of the unit cell others?"
        raise InputError.single(str(path), "power transmittance", "at most 1", got, remedy)
    return size_nm, t if time_sign == "minus" else t.conj()


def _exchanged(table: SweepTable, unit_cell: UnitCell, path: Path) -> tuple[FloatArray, ComplexArray, ComplexArray]:
    """Sizes and both amplitudes of a file with t_xx alone: t_yy(W, L) is t_xx(L, W) where x and y may be exchanged."""
    cell, (n_x, n_y) = unit_cell.cell, pillar_cell(unit_cell, 0.0, 0.0).n_substrate
    if cell.is_round and n_x == n_y and (unit_cell.has_square_lattice or cell.is_hexagonal):
        return table.size_nm, table.t_xx, table.t_xx
    by_size = {(w, h): t for (w, h), t in zip(table.size_nm.tolist(), table.t_xx, strict=True)}
    pairs = [(size, by_size.get((size[1], size[0]))) for size in by_size]
    if not is_square(unit_cell) or any(t is None for _, t in pairs):
        expected = "amplitudes of both polarisations, `t_xx` and `t_yy`"
        got = "one amplitude, which serves both in a square cell with every size in both orientations"
        raise InputError.single(str(path), "columns", expected, got)
    sizes = np.array([size for size, _ in pairs])
    return sizes, np.array(list(by_size.values())), np.array([t for _, t in pairs], dtype=np.complex128)


def _grid(unit_cell: UnitCell, size_nm: FloatArray, path: Path) -> tuple[UnitCell, SizeGrid]:
    """The unit cell with the sweep of the file, and its grid: whole steps from the smallest size of the file."""
    sweep, step = unit_cell.sweep, unit_cell.sweep.size_grid_nm
    spans = []
    for axis in (0, 1):
        low, high = float(size_nm[:, axis].min()), float(size_nm[:, axis].max())
        spans.append((low, low + step * np.floor((high - low) / step + 1e-6)))
    if spans[0][0] == spans[0][1] and spans[1][0] == spans[1][1]:
        expected = f"sizes over more than one step of `sweep.size_grid_nm`, {step:g} nm"
        raise InputError.single(str(path), "sizes", expected, f"{size_nm.min():g} to {size_nm.max():g} nm")
    (w_low, w_high), (l_low, l_high) = spans
    found = replace(sweep, width_nm=(w_low, float(w_high)), length_nm=(l_low, float(l_high)), axes=None)
    cell = replace(unit_cell, sweep=found)
    return cell, SizeGrid.of(cell)


def _spline(lines: FloatArray, t: ComplexArray) -> RBFInterpolator:
    """Spline of t, shape (n, 2), through points, shape (n, 1) or (n, 2); real and imaginary parts side by side."""
    parts = np.concatenate([t.real, t.imag], axis=1)
    return RBFInterpolator(lines, parts, neighbors=min(_NEAR, len(lines)), kernel="cubic", degree=1)


def _left_out_errors(lines: FloatArray, t: ComplexArray) -> FloatArray:
    """Largest |error| of both polarisations at each sample when it is predicted without its tenth, shape (n,).

    Samples in the corners of the range, where a prediction extrapolates, take the error of the nearest predicted one.
    """
    part = np.random.default_rng(1).permutation(len(lines)) % min(_PARTS, len(lines))
    low, high = lines.min(axis=0), lines.max(axis=0)
    inner = ~((lines == low) | (lines == high)).all(axis=1)
    missed = np.full(len(lines), np.nan)
    for number in range(part.max() + 1):
        out = (part == number) & inner
        if out.any():
            missed[out] = np.abs(_complex(_spline(lines[part != number], t[part != number])(lines[out])) - t[out]).max(
                1
            )
    predicted = np.isfinite(missed)
    if not predicted.any():
        return np.full(len(lines), np.abs(t - t.mean(axis=0)).max())
    if not predicted.all():
        missed[~predicted] = missed[predicted][cKDTree(lines[predicted]).query(lines[~predicted])[1]]
    return missed


def _complex(parts: FloatArray) -> ComplexArray:
    """Inverse of the parts of :func:`_spline`, shape (n, 4) -> (n, 2)."""
    return np.asarray(parts[:, :2] + 1j * parts[:, 2:])


def _on_grid(
    grid: SizeGrid, lines: FloatArray, t: ComplexArray, missed: FloatArray
) -> tuple[ComplexArray, FloatArray, float]:
    """Amplitudes, shape (n, 2), and errors, shape (n,), of all sizes of the grid, NaN outside the samples' hull.

    The third is the share of the sizes within the hull that lie between samples.
    """
    width, length = (axis.ravel() for axis in np.meshgrid(grid.width_nm, grid.length_nm))
    places = np.stack([width, length], axis=1)
    inside = width == length if grid.diagonal else _in_hull(places, lines)
    points = places[inside][:, : lines.shape[1]]
    values = np.full((len(places), 2), np.nan, dtype=np.complex128)
    error = np.full(len(places), np.nan)
    values[inside] = _complex(_spline(lines, t)(points))
    distance_nm, nearest = cKDTree(lines).query(points, k=[*range(1, min(_NEIGHBOURS, len(lines)) + 1)])
    between = np.asarray(distance_nm)[:, 0] > _SAME_NM
    error[inside] = np.where(between, missed[nearest].max(axis=1), _ROUNDING)
    return values, error, float(np.mean(between))


def _in_hull(places: FloatArray, lines: FloatArray) -> NDArray[np.bool_]:
    """Mask of the places within the convex hull of the samples, its edge included."""
    try:
        hull = Delaunay(lines)
    except QhullError:  # samples on one line
        return np.asarray(cKDTree(lines).query(places)[0] < _SAME_NM)
    return np.asarray(hull.find_simplex(places, tol=1e-9) >= 0)
