"""A library from a sweep that another program solved.

The sizes of the file are samples of smooth functions; the library holds their values on the grid of the unit cell's
``size_grid_nm`` between them. Between samples, local polyharmonic splines (radial basis functions r^3 with a linear
polynomial) go through all of them. Their error is that of leaving samples out: each tenth of the samples is predicted
from the others, which are then sparser than all samples, so that the prediction errs more than the library does. Where
one side has wider steps than the other, so is each of its lines of samples. Sizes of the file have no such error.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator
from scipy.spatial import Delaunay, cKDTree

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
#: Samples near a point that its spline uses; more where these lie on one line.
_NEAR = 32
#: Samples whose errors bound that of a point between them.
_NEIGHBOURS = 6
#: Ratio of the mean steps of both sides from which a left out sample has no neighbour as far away as the wide step:
#: one step of a row is twice as wide without a sample.
_WIDE = 1.5
#: Distance within which a size is that of a sample (nm), and the error there: the rounding of units and of decimals.
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
    missed = _left_out_errors(_coordinates(size_nm, size_nm)[0], t)
    values, error, share_between = _on_grid(grid, size_nm, t, missed)
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
        points_solved=len(size_nm),
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


def _coordinates(size_nm: FloatArray, places: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Coordinates of places, shape (m, 2), for the spline over samples ``size_nm``, shape (n, 2).

    They are (m, 2), widths and lengths, or (m, 1), distances (nm) along the line that holds all samples: circles,
    squares, one width or one length. The mask, shape (m,), is True on that line, and everywhere without one.
    """
    offset = size_nm - size_nm[0]
    direction = offset[np.argmax(np.hypot(*offset.T))] / np.hypot(*offset.T).max()
    normal = np.array([-direction[1], direction[0]])
    if np.abs(offset @ normal).max() > _SAME_NM:
        return places, np.ones(len(places), dtype=bool)
    away = places - size_nm[0]
    return (away @ direction)[:, None], np.abs(away @ normal) <= _SAME_NM


def _predicted(lines: FloatArray, t: ComplexArray, points: FloatArray) -> ComplexArray:
    """Spline of t, shape (n, 2), through samples, shape (n, 1) or (n, 2), at points: shape (m, 2)."""
    parts, near = np.concatenate([t.real, t.imag], axis=1), min(_NEAR, len(lines))
    while True:
        try:
            found = RBFInterpolator(lines, parts, neighbors=near, kernel="cubic", degree=1)(points)
            break
        except np.linalg.LinAlgError:  # the samples near a point lie on one line
            if near == len(lines):
                found = RBFInterpolator(lines, parts, neighbors=near, kernel="linear", degree=0)(points)
                break
            near = min(2 * near, len(lines))
    return np.asarray(found[:, :2] + 1j * found[:, 2:])


def _left_out_errors(lines: FloatArray, t: ComplexArray) -> FloatArray:
    """Largest |error| of both polarisations at each sample when it is predicted without others, shape (n,).

    It is left out with a tenth of the samples and, where one side has wider steps, with all of the same size there.
    Samples in the corners of the range, where a prediction extrapolates, take the error of the nearest predicted one.
    """
    is_end = (lines == lines.min(axis=0)) | (lines == lines.max(axis=0))
    part = np.random.default_rng(1).permutation(len(lines)) % min(_PARTS, len(lines))
    missed = _missed(lines, t, part, ~is_end.all(axis=1))
    ranks = [np.unique(axis, return_inverse=True)[1] for axis in lines.T]
    step_nm = np.ptp(lines, axis=0) / [rank.max() for rank in ranks]
    for axis in np.flatnonzero(step_nm > _WIDE * step_nm.min()):
        missed = np.maximum(missed, _missed(lines, t, ranks[axis] % _PARTS, ~is_end[:, axis]))
    return missed


def _missed(lines: FloatArray, t: ComplexArray, part: NDArray[np.intp], inner: NDArray[np.bool_]) -> FloatArray:
    """Largest |error| of ``inner`` samples predicted from those of all other parts, shape (n,) each.

    Other samples take that of the nearest inner one; without any, all take the largest deviation from the mean.
    """
    if not inner.any():
        return np.full(len(lines), np.abs(t - t.mean(axis=0)).max())
    missed = np.empty(len(lines))
    for number in np.unique(part[inner]):
        left_out, known = (part == number) & inner, part != number
        missed[left_out] = np.abs(_predicted(lines[known], t[known], lines[left_out]) - t[left_out]).max(axis=1)
    if not inner.all():
        missed[~inner] = missed[inner][cKDTree(lines[inner]).query(lines[~inner])[1]]
    return missed


def _on_grid(
    grid: SizeGrid, size_nm: FloatArray, t: ComplexArray, missed: FloatArray
) -> tuple[ComplexArray, FloatArray, float]:
    """Amplitudes, shape (n, 2), and errors, shape (n,), of all sizes of the grid, NaN outside the samples' hull.

    The third is the share of the sizes within the hull that lie between samples.
    """
    width, length = (axis.ravel() for axis in np.meshgrid(grid.width_nm, grid.length_nm))
    places, (lines, _) = np.stack([width, length], axis=1), _coordinates(size_nm, size_nm)
    points, inside = _coordinates(size_nm, places)
    inside &= _in_hull(points, lines)
    if not inside.any():
        expected, remedy = "a step from the smallest width and length to sizes of the file", "use the step of the file"
        raise InputError.single("unit cell", "sweep.size_grid_nm", expected, "none", remedy)
    values = np.full((len(places), 2), np.nan, dtype=np.complex128)
    error = np.full(len(places), np.nan)
    distance_nm, nearest = cKDTree(size_nm).query(places[inside], k=[*range(1, min(_NEIGHBOURS, len(lines)) + 1)])
    between = np.asarray(distance_nm)[:, :1] > _SAME_NM
    values[inside] = np.where(between, _predicted(lines, t, points[inside]), t[np.asarray(nearest)[:, 0]])
    error[inside] = np.where(between[:, 0], missed[nearest].max(axis=1), _ROUNDING)
    return values, error, float(np.mean(between))


def _in_hull(points: FloatArray, lines: FloatArray) -> NDArray[np.bool_]:
    """Mask of the points within the convex hull of the samples, its edge included."""
    if lines.shape[1] == 1:
        return np.asarray((points >= lines.min() - _SAME_NM) & (points <= lines.max() + _SAME_NM))[:, 0]
    return np.asarray(Delaunay(lines).find_simplex(points, tol=1e-9) >= 0)
