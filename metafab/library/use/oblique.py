"""Light that meets the pillars at an angle: how their transmission changes, and the error where that is left out.

By the mirror symmetry of a pillar, t is even in both cosines u_x and u_y of the light's direction. It is expanded to

    t(s; u) = t(s) + a(s) u_x^2 + b(s) u_x^4 + c(s) u_y^2 + d(s) u_y^4

for each size s. Two solved angles in each plane give the coefficients of a size. Those of the other sizes are rational
functions of width and length: odd guided modes, which light along the axis does not excite, are further poles. The term
in u_x^2 u_y^2 and cross-polarised light are left out. The error is that of sizes and of a direction that were not
fitted; it holds the former, not the latter.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from metafab.cell import CellNumerics, PillarCell, is_square, pillar_cell, solve
from metafab.cell.rcwa import RcwaDetails, zero_order
from metafab.cell.response import power_ratio
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.parallel.forked import shared
from metafab.core.parallel.work import Work
from metafab.library.fit.rational import Samples, Shape, fit_model
from metafab.library.library import Library
from metafab.spec import UnitCell

#: Sizes solved for the error of light along the axis, each standing for an equal share of the pillars.
_ERROR_SIZES = 8
#: Target error of the solution along the axis. The oblique one has the same truncation, whose error is common to both
#: and cancels. The changes of three draws of sizes were within 0.9 % of those at 8 cosines.
_SOLVER_ERROR = 3e-2
#: Most sizes solved for the coefficients. Of the paper's lens 96 leave 0.1 % of the field at 3.6 degrees, 64 0.2 %.
_FITTED_SIZES = 96
#: Every so many of them one ranks the degrees of the fits, and another one measures their error.
_HELD_OUT = 8
#: Smaller angle of each plane over the larger one, by their cosines.
_INNER = 0.6
#: Degrees of the fits that are tried, and their most coefficients, as a share of the equations.
_SHAPES = tuple(Shape(degrees) for degrees in ((1, 0), (2, 1), (3, 2), (4, 3), (4, 4), (5, 4), (6, 5), (8, 6), (8, 8)))
_FILLING = 0.6

#: Direction of light before the substrate, (x/z, y/z).
Direction = tuple[float, float]


@dataclass(frozen=True)
class ObliqueChange:
    """Change of the light of a mask's pillars by the direction of the light."""

    #: Shape (n_sizes, 4, 2), coefficients of :func:`powers` for x and y polarisation, in square roots of power.
    coefficients: ComplexArray
    reach: float  #: Largest cosine along x and y for which they hold.
    #: Relative rms change of the field from the corner of the field to the axis, without the common phase.
    change: float
    left: float  #: That of the field by the coefficients, at sizes that were not fitted.


def powers(direction: Direction) -> FloatArray:
    """Return u_x^2, u_x^4, u_y^2, u_y^4 of the cosines of a direction, shape (4,)."""
    square = np.square(direction) / (1.0 + direction[0] ** 2 + direction[1] ** 2)
    return np.asarray(np.stack([square, square**2], axis=1).ravel(), dtype=np.float64)


def reach_of(corner: Direction) -> float:
    """Return the largest cosine along x and y that is solved for a field with this corner."""
    return max(abs(tangent) for tangent in corner) / math.hypot(1.0, *corner)


def is_solved_at_angles(unit_cell: UnitCell) -> bool:
    """Whether RCWA solves the pillars of a unit cell quickly under oblique light.

    It is slow for other outlines than rectangles, sloped walls, hexagonal lattices and birefringent substrates, and no
    light comes at an angle out of an absorbing medium.
    """
    cell = pillar_cell(unit_cell, max(unit_cell.sweep.width_nm), max(unit_cell.sweep.length_nm))
    is_slow = cell.untreated("", treated=("under, over",))
    return not is_slow and complex(cell.n_of_angle).imag == 0.0 and cell.n_substrate[0] == cell.n_substrate[1]


def oblique_field_error(
    library: Library,
    size_nm: FloatArray,
    pillars: NDArray[np.integer],
    direction: Direction,
    workers: int | None = None,
) -> float | None:
    """Return the relative rms change of a mask's zero-order field under oblique light, without the common phase.

    Args:
        library: its unit cell is solved along the axis and from the side.
        size_nm: shape (n, 2), width and length of each size of the mask.
        pillars: shape (n,), number of pillars of each size.
        direction: direction of the light.
        workers: processes that solve; None for all cores.

    Returns:
        The larger of both polarisations'; None without pillars, and where :func:`is_solved_at_angles` says no.
    """
    places = _even_shares(pillars, _ERROR_SIZES)
    if not places.size or not is_solved_at_angles(library.unit_cell):
        return None
    t = np.array(list(shared(partial(_solved, library, (direction,)), size_nm[places].tolist(), workers)))
    return _largest_change(t[:, 0], t[:, 1], np.ones(places.size))


def oblique_change(
    library: Library,
    size_nm: FloatArray,
    pillars: NDArray[np.integer],
    corner: Direction,
    work: Work = Work(),
) -> ObliqueChange | None:
    """Solve sizes of a mask from the side and fit the coefficients of all its sizes.

    A mask of at most 96 sizes has all of them solved and none fitted.

    Args:
        library: as for :func:`oblique_field_error`, and so are ``size_nm``, ``pillars`` and the case of None.
        size_nm: shape (n, 2).
        pillars: shape (n,).
        corner: direction of the corner of the field.
        work: processes that solve, and progress over the sizes.
    """
    used = np.flatnonzero(pillars)
    if not used.size or not is_solved_at_angles(library.unit_cell):
        return None
    chosen = used if used.size <= _FITTED_SIZES else np.unique(_even_shares(pillars, _FITTED_SIZES))
    reach = reach_of(corner)
    slopes = [cosine / math.sqrt(1.0 - cosine**2) for cosine in (_INNER * reach, reach)]
    in_planes = [(slope, 0.0) for slope in slopes] + [(0.0, slope) for slope in slopes]
    tested = np.arange(chosen.size) % _HELD_OUT == _HELD_OUT - 1
    tested[-1:] |= not tested.any()
    sizes = size_nm[chosen]
    jobs = [
        (size, (*in_planes, corner) if test else in_planes) for size, test in zip(sizes.tolist(), tested, strict=True)
    ]
    empty = pillar_cell(library.unit_cell, 0.0, 0.0)
    by_power = np.sqrt([power_ratio(_inclined(empty, each)) for each in ((0.0, 0.0), *in_planes, corner)])
    solved: list[ComplexArray] = []
    work.progress("oblique light", 0, len(jobs))
    for t in shared(partial(_solved_towards, library), jobs, work.workers):
        solved.append(t * by_power[: len(t)])
        work.progress("oblique light", len(solved), len(jobs))
    changes = np.array([(each[1:5] - each[0]).reshape(2, 2, 2) for each in solved])
    if chosen is used:
        fitted = np.zeros((len(size_nm), 2, 2, 2), dtype=np.complex128)
        fitted[used] = changes
    else:
        fitted = _fitted_changes(library, sizes, changes, tested, size_nm)
    square = np.square([_INNER * reach, reach])
    expansion = np.linalg.inv(np.stack([square, square**2], axis=1))
    coefficients = np.einsum("ka,npac->npkc", expansion, fitted).reshape(len(size_nm), 4, 2)
    coefficients[pillars == 0] = 0.0
    before, after = np.array([each[[0, -1]] for each, test in zip(solved, tested, strict=True) if test]).swapaxes(0, 1)
    predicted = before + np.einsum("k,nkc->nc", powers(corner), coefficients[chosen[tested]])
    weight = pillars[chosen[tested]] if chosen is used else np.ones(len(before))
    return ObliqueChange(
        coefficients, reach, _largest_change(before, after, weight), _largest_change(predicted, after, weight)
    )


def _even_shares(pillars: NDArray[np.integer], count: int) -> NDArray[np.intp]:
    """Numbers of ``count`` sizes that stand for equal shares of the pillars; none without pillars."""
    total = np.cumsum(pillars)
    if not total.size or total[-1] == 0:
        return np.zeros(0, dtype=np.intp)
    return np.asarray(np.searchsorted(total, (np.arange(count) + 0.5) / count * total[-1]), dtype=np.intp)


def _solved_towards(library: Library, job: tuple[tuple[float, float], tuple[Direction, ...]]) -> ComplexArray:
    size, directions = job
    return _solved(library, directions, size)


def _solved(library: Library, directions: tuple[Direction, ...], size_nm: tuple[float, float]) -> ComplexArray:
    """Zero-order t_xx and t_yy along the axis and from ``directions`` at one truncation, shape (1 + directions, 2)."""
    straight = pillar_cell(library.unit_cell, *size_nm)
    along_axis = solve(straight, CellNumerics(target_error=_SOLVER_ERROR))
    assert isinstance(along_axis.details, RcwaDetails)
    from_side = [zero_order(_inclined(straight, each), along_axis.details.orders_x).t for each in directions]
    return np.array([np.diagonal(t) for t in (along_axis.t, *from_side)])


def _inclined(cell: PillarCell, direction: Direction) -> PillarCell:
    """The cell under light from a direction before the substrate."""
    slope = math.hypot(*direction)
    sine = slope / math.hypot(1.0, slope) / complex(cell.n_of_angle).real
    azimuth_deg = math.degrees(math.atan2(direction[1], direction[0]))
    return replace(cell, angle_deg=math.degrees(math.asin(sine)), azimuth_deg=azimuth_deg)


def _fitted_changes(
    library: Library, sizes: FloatArray, changes: ComplexArray, tested: NDArray[np.bool_], size_nm: FloatArray
) -> ComplexArray:
    """Changes of all sizes of the mask by fits to the solved sizes without those ``tested``.

    The solved changes, shape (n, 2, 2, 2), are those by plane of incidence, angle and polarisation; the returned ones
    have the shape (n_sizes, 2, 2, 2). Where x and y can be exchanged, both planes are one fit.
    """
    known, sweep = ~tested, library.unit_cell.sweep
    spans_nm = sweep.width_nm, sweep.length_nm
    if not is_square(library.unit_cell):
        planes = [_fit(sizes, changes[:, plane], known, spans_nm, size_nm) for plane in (0, 1)]
        return np.stack(planes, axis=1)
    both = np.concatenate([sizes, sizes[:, ::-1]])
    in_plane = np.concatenate([changes[:, 0], changes[:, 1, :, ::-1]])
    union_nm = min(np.ravel(spans_nm)), max(np.ravel(spans_nm))
    places = np.concatenate([size_nm, size_nm[:, ::-1]])
    x, y = np.split(_fit(both, in_plane, np.tile(known, 2), (union_nm, union_nm), places), 2)
    return np.stack([x, y[..., ::-1]], axis=1)


def _fit(
    sizes: FloatArray,
    changes: ComplexArray,
    known: NDArray[np.bool_],
    spans_nm: tuple[tuple[float, float], tuple[float, float]],
    size_nm: FloatArray,
) -> ComplexArray:
    """Rational fits to the ``known`` changes, shape (n, 2 angles, 2 polarisations), at the sizes of a mask.

    The degrees are those of the smallest error at every eighth known size, which the fits of the ranking leave out. No
    change is larger than the largest one that was solved: a fit may have a pole where there are few pillars.
    """
    found = []
    ranking = known & (np.arange(len(sizes)) % _HELD_OUT == _HELD_OUT // 2 - 1)
    for values in np.moveaxis(changes, 1, 0):
        fit = partial(_fitted_by, sizes, values, spans_nm)

        def miss(shape: Shape, fit: Callable[..., ComplexArray] = fit, values: ComplexArray = values) -> float:
            return float(np.linalg.norm(fit(known & ~ranking, shape, sizes[ranking]) - values[ranking]))

        most = _FILLING * np.count_nonzero(known & ~ranking)
        at_sizes = fit(known, min((shape for shape in _SHAPES if sum(shape.terms) <= most), key=miss), size_nm)
        largest = np.abs(values[known]).max(axis=0)
        found.append(at_sizes / np.maximum(np.abs(at_sizes) / largest, 1.0))
    return np.stack(found, axis=1)


def _fitted_by(
    sizes: FloatArray,
    values: ComplexArray,
    spans_nm: tuple[tuple[float, float], tuple[float, float]],
    which: NDArray[np.bool_],
    shape: Shape,
    places: FloatArray,
) -> ComplexArray:
    """Rational function of ``shape`` through ``values``, shape (n, 2), of the sizes ``which``, at ``places``."""
    count = int(np.count_nonzero(which))
    no_axes, no_slopes = np.zeros((count, 0)), np.full((count, 2, 4), np.nan + 0j)
    samples = Samples(sizes[which, 0], sizes[which, 1], np.tile(values[which], 2), no_axes, no_slopes)
    return fit_model(samples, shape, spans_nm, None, penalised=True)(places[:, 0], places[:, 1])[:, :2]


def _largest_change(before: ComplexArray, after: ComplexArray, weight: FloatArray) -> float:
    """Relative rms change, the larger of both polarisations', without the phase that all share; shape (n, 2) each."""
    root = np.sqrt(weight)[:, None]
    common = np.exp(1j * np.angle(np.sum(weight[:, None] * after * before.conj(), axis=0)))
    changed = np.linalg.norm(root * (after - common * before), axis=0)
    return float(np.max(changed / np.linalg.norm(root * before, axis=0)))
