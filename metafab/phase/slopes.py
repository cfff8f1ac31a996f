"""Slopes of target phases: the direction into which they send the light, and where the lattice undersamples them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import POLARISATIONS, FloatArray, wrap_phase
from metafab.core.storage.files import Latest, file_mark
from metafab.phase.formulas import plain_term
from metafab.phase.terms.profile import Term
from metafab.spec import terms as spec
from metafab.spec.design import Design

#: Places along a side of the aperture at which the mean slope of a target is taken.
_SLOPE_PLACES = 128
#: Periods over which the slope of a formula is taken, and least number of periods for that of an array. Over four
#: periods a jump by half a turn, as at an outline, adds an eighth of a turn from pillar to pillar, and levels count as
#: the slope that they approximate.
_LOCAL, _WINDOW = 1e-3, 4.0
#: Relative rounding of a phase step of exactly half a turn from pillar to pillar.
_ROUNDING = 1e-6
#: The direction that was found last; each step of a run needs it.
_DIRECTIONS: Latest[tuple[tuple[float, float], tuple[float, float]]] = Latest()


def mean_direction(design: Design) -> tuple[tuple[float, float], tuple[float, float]]:
    """Direction cosines (x, y) that the mean slope of a design's own phases adds, for x and y polarised light.

    Arrays and Zernike polynomials count; an unusable array raises InputError. Gratings have their own direction;
    lenses, helices and holograms are centred on it. The slope is the mean over the aperture of the wrapped difference
    between neighbouring sites. A step of half a turn, as of a binary phase, points both ways and counts as none.
    """
    own = tuple(term for term in design.phase if term.is_own)
    if not own:
        return (0.0, 0.0), (0.0, 0.0)
    files = [term.file for term in own if isinstance(term, spec.UserArray) and term.file.is_file()]
    key = (own, design.device, design.wavelength_um, design.unit_cell.cell.period_nm, *map(file_mark, files))
    return _DIRECTIONS.of(key, lambda: _mean_direction(design, [plain_term(design, term) for term in own]))


def _mean_direction(design: Design, terms: list[Term]) -> tuple[tuple[float, float], tuple[float, float]]:
    # Over a whole period: where the pillars alias a slope, the light goes into the direction of the alias.
    period_x_nm, period_y_nm = design.unit_cell.cell.period_nm
    period_um, inside = (1e-3 * period_x_nm, 1e-3 * period_y_nm), _inside(design)
    slopes = _slopes(design, terms, period_um)
    half_turns = np.abs(slopes) * np.array(period_um)[:, None, None] > np.pi * (1.0 - _ROUNDING)
    mean = np.where(half_turns, 0.0, slopes)[..., inside].sum(axis=-1) / max(1, np.count_nonzero(inside))
    cosines = mean * design.wavelength_um / (2.0 * np.pi)
    (x_x, x_y), (y_x, y_y) = cosines.tolist()
    return (x_x, x_y), (y_x, y_y)


def _places_um(design: Design) -> FloatArray:
    """Coordinates along a side of the aperture at which slopes are taken, shape (n,)."""
    return ((np.arange(_SLOPE_PLACES) + 0.5) / _SLOPE_PLACES - 0.5) * design.device.aperture_um


def _inside(design: Design) -> NDArray[np.bool_]:
    """Places of the slopes that lie within the aperture, shape (n, n)."""
    places = _places_um(design)
    return design.device.encloses(places, places)


def _slopes(
    design: Design, terms: Sequence[Term], step_um: tuple[float, float], counts: tuple[int, int] = (1, 1)
) -> FloatArray:
    """Mean slopes, rad/um, over ``counts`` wrapped steps along x and y.

    Shape (2, 2, n, n): polarisation, axis, and the places in rows along y.
    """
    places = _places_um(design)
    slopes = np.zeros((2, 2, places.size, places.size))
    for p, name in enumerate(POLARISATIONS):
        for axis, (step, count) in enumerate(zip(step_um, counts, strict=True)):
            phases = []
            for number in range(count + 1):
                x, y = (places + (number - 0.5 * count) * step * (axis == along) for along in (0, 1))
                phases.append(sum((term(x, y, name) for term in terms), np.zeros(slopes.shape[2:])))
            turned = sum(wrap_phase(after - before) for before, after in pairwise(phases))
            slopes[p, axis] = turned / (count * step)
    return slopes


def undersampled_share(design: Design) -> float:
    """Share of the aperture where the target phase is too steep for the lattice of the pillars.

    There it turns by more than pi from pillar to pillar, so that a flatter phase, with one turn per pillar less, has
    the same values and takes the light: the slope lies beyond the first Brillouin zone of the lattice. The larger share
    of both polarisations counts. The slope of an array is the mean of its steps from sample to sample over a few
    periods, since the interpolation between them is uneven. Terms with jumps, such as helices and holograms, are left
    out. An unusable array raises InputError.
    """
    period_um = 1e-3 * np.array(design.unit_cell.cell.period_nm)
    formulas = []
    slopes = np.zeros((2, 2, _SLOPE_PLACES, _SLOPE_PLACES))
    for term in design.phase:
        if isinstance(term, spec.UserArray):
            count_x, count_y = np.ceil(_WINDOW * period_um / term.pitch_um).astype(int).tolist()
            step_um = term.pitch_um, term.pitch_um
            slopes += _slopes(design, [plain_term(design, term)], step_um, (count_x, count_y))
        elif term.is_smooth:
            formulas.append(plain_term(design, term))
    near_x_um, near_y_um = (_LOCAL * period_um).tolist()
    slopes += _slopes(design, formulas, (near_x_um, near_y_um))
    along_x, along_y = 2.0 * np.pi / period_um
    # Shortest reciprocal lattice vectors, rad/um; every other row of a hexagonal lattice is offset by half a period.
    if design.unit_cell.cell.is_hexagonal:
        shortest = [(along_x, 0.5 * along_y), (along_x, -0.5 * along_y), (0.0, along_y)]
    else:
        shortest = [(along_x, 0.0), (0.0, along_y)]
    largest = 0.5 * (1.0 + _ROUNDING)
    beyond = [np.abs(slopes[:, 0] * gx + slopes[:, 1] * gy) > largest * (gx**2 + gy**2) for gx, gy in shortest]
    inside = _inside(design)
    return float(np.any(beyond, axis=0)[:, inside].mean(axis=-1).max()) if inside.any() else 0.0
