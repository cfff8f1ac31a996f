"""Pillars with measured sizes: a table of places and sizes, as from electron micrographs, over the pillars of a mask.

Each measured pillar takes its size. The others take the bias (measured less drawn width and length) of the measured
pillars around them, weighted by the inverse squared distance to the nearest four.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.layout.pillars import PillarMap
from metafab.layout.resized import resized
from metafab.library import Library

_COLUMNS = ("x_um", "y_um", "width_nm", "length_nm")
#: Measured pillars around a place whose bias it takes.
_NEAREST = 4


def with_measured_sizes(pillars: PillarMap, path: Path, library: Library) -> PillarMap:
    """Return the pillars of a mask with the sizes of a table.

    Args:
        pillars: upright pillars as drawn.
        path: .csv with the columns x_um and y_um, from the axis, and width_nm and length_nm.
        library: its range of sizes limits those of the pillars.

    Raises:
        InputError: a table that cannot be read, a place without a pillar or given twice, or sizes beyond the library;
            the message states the share of these pillars.
    """
    rows = _read(path)
    site = _sites(pillars, rows[:, :2], path)
    index, drawn_nm = pillars.to_array(), pillars.size_nm()
    bias_nm = rows[:, 2:] - drawn_nm[index[site]]
    x_um, y_um = pillars.lattice.x_um(), pillars.lattice.y_um()
    tree = cKDTree(rows[:, :2])
    count = min(_NEAREST, len(rows))

    def sizes_nm(band: slice) -> FloatArray:
        """Drawn sizes plus the bias around each site of a band of rows; measured sizes where there are any."""
        here = index[band]
        size_nm = np.moveaxis(drawn_nm[here], -1, 0).copy()
        row, column = np.nonzero(here)
        places = np.stack([x_um[column], y_um[band][row]], axis=1)
        distance, near = tree.query(places, k=range(1, count + 1))
        weight = 1.0 / np.maximum(distance, 1e-6) ** 2
        bias = (bias_nm[near] * weight[..., None]).sum(axis=1) / weight.sum(axis=1)[:, None]
        size_nm[:, row, column] += bias.T
        inside = (site[0] >= band.start) & (site[0] < band.stop)
        size_nm[:, site[0][inside] - band.start, site[1][inside]] = rows[inside, 2:].T
        return size_nm

    made = resized(pillars, sizes_nm)
    _require_known(made, library, path)
    return made


def _read(path: Path) -> FloatArray:
    """Places and sizes, shape (n, 4)."""
    expected = f"a .csv file with the columns {', '.join(_COLUMNS)}"
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            table = list(csv.DictReader(line for line in stream if line.strip() and not line.startswith("#")))
        rows = np.array([[float(row[name]) for name in _COLUMNS] for row in table], dtype=np.float64)
    except KeyError as error:
        raise InputError.single(str(path), "columns", expected, f"no column {error.args[0]}") from error
    except (OSError, ValueError, TypeError, csv.Error) as error:
        raise InputError.single(str(path), "file", expected, f"an unreadable one ({error})") from error
    if not rows.size or not np.isfinite(rows).all() or (rows[:, 2:] <= 0.0).any():
        got = f"{len(rows)} rows" if not rows.size else "sizes that are not positive, or numbers that are not finite"
        raise InputError.single(str(path), "rows", "at least one, with finite places and positive sizes", got)
    return rows


def _sites(pillars: PillarMap, places_um: FloatArray, path: Path) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Row and column of the pillar nearest to each place, within half a pitch."""
    axes = pillars.lattice.y_um(), pillars.lattice.x_um()
    pitch_um = [1e-3 * period * pillars.lattice.database_unit_nm for period in pillars.lattice.period_dbu[::-1]]
    row, column = (
        np.clip(np.rint((places_um[:, 1 - k] - axes[k][0]) / pitch_um[k]).astype(np.int64), 0, axes[k].size - 1)
        for k in (0, 1)
    )
    off = np.maximum(*(np.abs(places_um[:, 1 - k] - axes[k][n]) / pitch_um[k] for k, n in ((0, row), (1, column))))
    missing = (off > 0.5) | (pillars.to_array()[row, column] == 0)
    if missing.any():
        x, y = places_um[missing][0]
        got = f"{int(missing.sum())} of {missing.size} without one, such as ({x:g}, {y:g}) um"
        raise InputError.single(str(path), "places", "a pillar of the mask within half a period", got, "from the axis?")
    _, first, count = np.unique(np.stack([row, column]), axis=1, return_index=True, return_counts=True)
    if (count > 1).any():
        x, y = places_um[first[count > 1][0]]
        raise InputError.single(str(path), "places", "each pillar once", f"the one at ({x:g}, {y:g}) um twice")
    return row, column


def _require_known(pillars: PillarMap, library: Library, path: Path) -> None:
    """Refuse sizes beyond those of the library."""
    size_nm = pillars.size_nm()
    used = np.bincount(pillars.to_array().ravel(), minlength=len(size_nm))
    used[0] = 0
    beyond = np.zeros(len(size_nm), dtype=bool)
    for axis, known_nm in ((0, library.width_nm), (1, library.length_nm)):
        beyond |= (size_nm[:, axis] < known_nm[0] - 1e-6) | (size_nm[:, axis] > known_nm[-1] + 1e-6)
    if not used[beyond].any():
        return
    spans = " x ".join(f"{known_nm[0]:g} to {known_nm[-1]:g}" for known_nm in (library.width_nm, library.length_nm))
    worst = size_nm[beyond & (used > 0)][0]
    share = 100.0 * used[beyond].sum() / used.sum()
    got = f"{share:.2g} % of the pillars beyond, such as {worst[0]:g} x {worst[1]:g} nm"
    raise InputError.single(str(path), "sizes", f"sizes of the library, {spans} nm", got, "widen its sweep")
