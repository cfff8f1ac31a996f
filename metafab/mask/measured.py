"""Measured sizes of pillars of a mask, from a table of places and sizes, such as one from electron micrographs."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.storage.limits import require_modest_table
from metafab.layout import PillarMap

_SIZES, _DIAMETER = ("width_nm", "length_nm"), "diameter_nm"
#: Largest median ratio of measured and drawn sizes: beyond it the unit is wrong.
_LARGEST_RATIO = 5.0
#: Largest median distance of the places from their pillars along an axis, periods: beyond it, some sizes are given to
#: the next pillar.
_LARGEST_OFFSET = 0.25
#: Sizes belong to pillars one site on if they spread about those by less than this share of their spread here.
_BETTER = 0.5
#: Fewest pillars for that comparison.
_ENOUGH = 8


@dataclass(frozen=True, eq=False)
class MeasuredTable:
    """Rows of a table of measured pillars."""

    path: Path  #: The file.
    place_um: FloatArray  #: Shape (n, 2), x and y from the axis of the lens.
    size_nm: FloatArray  #: Shape (n, 2), width and length.
    further: Mapping[str, FloatArray]  #: Other columns by name, shape (n,) each.
    has_diameters: bool = False  #: Whether the file names diameters; then widths equal lengths.

    def part(self, rows: NDArray[np.bool_]) -> MeasuredTable:
        """Return some of the rows: shape (n,), whether a row is kept."""
        further = {name: column[rows] for name, column in self.further.items()}
        return MeasuredTable(self.path, self.place_um[rows], self.size_nm[rows], further, self.has_diameters)

    def sites(self, pillars: PillarMap) -> NDArray[np.int64]:
        """Row and column of the pillar at each place, within half a pitch: shape (n, 2).

        InputError if no pillar stands at a place, the sizes cannot be in nm, or the places as a whole are shifted.
        """
        axes = pillars.lattice.y_um(), pillars.lattice.x_um()
        pitch_um = [1e-3 * period * pillars.lattice.database_unit_nm for period in pillars.lattice.period_dbu[::-1]]
        place = self.place_um[:, ::-1]
        exact = [(place[:, k] - axes[k][0]) / pitch_um[k] for k in (0, 1)]
        row, column = (np.clip(np.rint(exact[k]).astype(np.int64), 0, axes[k].size - 1) for k in (0, 1))
        off = np.maximum(np.abs(exact[0] - row), np.abs(exact[1] - column))
        missing = (off > 0.5) | (pillars.to_array()[row, column] == 0)
        if missing.any():
            x, y = self.place_um[missing][0]
            got = f"{int(missing.sum())} of {missing.size} without one, such as ({x:g}, {y:g}) um"
            expected = "a pillar of the mask within half a period"
            raise InputError.single(str(self.path), "places", expected, got, "are they from the axis of the lens?")
        drawn_nm = pillars.size_nm()[pillars.to_array()[row, column]]
        ratio = float(np.median(self.size_nm / drawn_nm))
        if not 1.0 / _LARGEST_RATIO < ratio < _LARGEST_RATIO:
            got = f"sizes that are {ratio:.3g} times those in the median"
            raise InputError.single(str(self.path), "sizes", "sizes near the drawn ones, in nm", got, "check the unit")
        sites = np.stack([row, column], axis=1)
        self._require_unshifted(pillars, sites, np.array(pitch_um), np.stack(exact, axis=1) - sites)
        return sites

    def _require_unshifted(
        self, pillars: PillarMap, sites: NDArray[np.int64], pitch_um: FloatArray, off: FloatArray
    ) -> None:
        """Refuse places that lie beside their pillars in the median, or whose sizes are those of pillars a site on.

        ``pitch_um`` along y and x; ``off`` of the places from ``sites``, periods, shape (n, 2), y and x.
        """
        index, drawn_nm, last = pillars.to_array(), pillars.size_nm(), np.array(pillars.lattice.shape) - 1

        def spread_nm(step: tuple[int, ...]) -> float:
            """Mean deviation of measured less drawn sizes from their median, of the pillars a step beside ``sites``."""
            there = sites + step
            inside = np.asarray(((there >= 0) & (there <= last)).all(axis=1))
            inside[inside] = index[tuple(there[inside].T)] > 0
            bias_nm = self.size_nm[inside] - drawn_nm[index[tuple(there[inside].T)]]
            enough = 2 * np.count_nonzero(inside) >= max(len(sites), 2 * _ENOUGH)
            return float(np.abs(bias_nm - np.median(bias_nm, axis=0)).sum(axis=1).mean()) if enough else math.inf

        spreads_nm = {step: spread_nm(step) for step in product((-1, 0, 1), repeat=2)}
        step = min(spreads_nm, key=lambda each: spreads_nm[each])
        if not spreads_nm[step] < _BETTER * spreads_nm[0, 0]:
            step = (0, 0)
        offset = np.median(off, axis=0) - step
        if np.abs(offset).max() <= _LARGEST_OFFSET:
            return
        y, x = np.round(offset * pitch_um, 3) + 0.0
        got = f"places shifted by ({x:g}, {y:g}) um in the median"
        if step != (0, 0):
            got += f" (sizes fit the drawn ones there to {spreads_nm[step]:.2g} nm, here to {spreads_nm[0, 0]:.2g} nm)"
        expected = f"places within {_LARGEST_OFFSET:g} periods of their pillars"
        remedy = f"subtract ({x:g}, {y:g}) from x_um and y_um, which are from the axis of the lens"
        raise InputError.single(str(self.path), "places", expected, got, remedy)

    def require_each_once(self, *of: NDArray[np.float64] | NDArray[np.int64]) -> None:
        """Refuse rows that agree in all columns ``of``, shape (n,) or (n, m) each.

        InputError with the first such place.
        """
        _, first, count = np.unique(np.column_stack(of), axis=0, return_index=True, return_counts=True)
        if (count > 1).any():
            x, y = self.place_um[first[count > 1][0]]
            raise InputError.single(str(self.path), "places", "each pillar once", f"the one at ({x:g}, {y:g}) um twice")


def read_measured(path: Path, optional: Sequence[str] = ()) -> MeasuredTable:
    """Read a .csv file with places and sizes and, where it has them, ``optional`` columns; # begins a comment.

    Places are ``x_um`` and ``y_um``, sizes ``width_nm`` and ``length_nm``, or ``diameter_nm``. InputError for a table
    that cannot be read, sizes that are not positive, or numbers that are not finite.
    """
    expected = "a .csv file with the columns x_um, y_um, width_nm and length_nm (or diameter_nm)"
    try:
        require_modest_table(path)
        with path.open(encoding="utf-8-sig", newline="") as stream:
            reader = csv.DictReader(line for line in stream if line.strip() and not line.startswith("#"))
            header = reader.fieldnames or ()
            table, present = list(reader), [name for name in optional if name in header]
        has_diameters = _DIAMETER in header and not any(name in header for name in _SIZES)
        names = ["x_um", "y_um", *((_DIAMETER, _DIAMETER) if has_diameters else _SIZES), *present]
        for number, row in enumerate(table, start=1):
            if empty := [name for name in names if name in row and not (row[name] or "").strip()]:
                got, remedy = f"row {number} without {empty[0]}", "leave out pillars that were not measured"
                raise InputError.single(str(path), "rows", "a number in each column", got, remedy)
        rows = np.array([[float(row[name]) for name in names] for row in table], dtype=np.float64)
    except KeyError as error:
        raise InputError.single(str(path), "columns", expected, f"no column {error.args[0]}") from error
    except (OSError, ValueError, TypeError, csv.Error) as error:
        raise InputError.single(str(path), "file", expected, f"an unreadable one ({error})") from error
    if not rows.size or not np.isfinite(rows).all() or (rows[:, 2:4] <= 0.0).any():
        got = f"{len(rows)} rows" if not rows.size else "sizes that are not positive, or numbers that are not finite"
        raise InputError.single(str(path), "rows", "at least one, with finite places and positive sizes", got)
    further = dict(zip(present, rows[:, 4:].T, strict=True))
    return MeasuredTable(path, rows[:, :2], rows[:, 2:4], further, has_diameters)
