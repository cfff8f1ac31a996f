"""Measured sizes of pillars of a mask, from a table of places and sizes as of electron micrographs."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.storage.limits import require_modest_table
from metafab.layout import PillarMap

COLUMNS = ("x_um", "y_um", "width_nm", "length_nm")
#: Largest median ratio of measured and drawn sizes: beyond it the unit is wrong.
_LARGEST_RATIO = 5.0


@dataclass(frozen=True, eq=False)
class MeasuredTable:
    """Rows of a table of measured pillars."""

    path: Path  #: The file.
    place_um: FloatArray  #: Shape (n, 2), x and y from the axis of the lens.
    size_nm: FloatArray  #: Shape (n, 2), width and length.
    further: Mapping[str, FloatArray]  #: Other columns by name, shape (n,) each.

    def part(self, rows: NDArray[np.bool_]) -> MeasuredTable:
        """Return some of the rows: shape (n,), whether a row is kept."""
        further = {name: column[rows] for name, column in self.further.items()}
        return MeasuredTable(self.path, self.place_um[rows], self.size_nm[rows], further)

    def sites(self, pillars: PillarMap) -> NDArray[np.int64]:
        """Row and column of the pillar at each place, within half a pitch: shape (n, 2).

        InputError if no pillar stands at a place, or the sizes cannot be in nm.
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
            raise InputError.single(str(self.path), "places", expected, got, "from the axis?")
        drawn_nm = pillars.size_nm()[pillars.to_array()[row, column]]
        ratio = float(np.median(self.size_nm / drawn_nm))
        if not 1.0 / _LARGEST_RATIO < ratio < _LARGEST_RATIO:
            got = f"sizes that are {ratio:.3g} times those in the median"
            raise InputError.single(str(self.path), "sizes", "sizes near the drawn ones, in nm", got, "check the unit")
        return np.stack([row, column], axis=1)

    def require_each_once(self, *of: NDArray[np.float64] | NDArray[np.int64]) -> None:
        """Refuse rows that agree in all columns ``of``, shape (n,) or (n, m) each.

        InputError with the first such place.
        """
        _, first, count = np.unique(np.column_stack(of), axis=0, return_index=True, return_counts=True)
        if (count > 1).any():
            x, y = self.place_um[first[count > 1][0]]
            raise InputError.single(str(self.path), "places", "each pillar once", f"the one at ({x:g}, {y:g}) um twice")


def read_measured(path: Path, optional: Sequence[str] = ()) -> MeasuredTable:
    """Read a .csv file with the columns :data:`COLUMNS` and, where it has them, ``optional`` ones; # begins a comment.

    InputError for a table that cannot be read, sizes that are not positive, or numbers that are not finite.
    """
    expected = f"a .csv file with the columns {', '.join(COLUMNS)}"
    try:
        require_modest_table(path)
        with path.open(encoding="utf-8-sig", newline="") as stream:
            reader = csv.DictReader(line for line in stream if line.strip() and not line.startswith("#"))
            table, present = list(reader), [name for name in optional if name in (reader.fieldnames or ())]
        names = [*COLUMNS, *present]
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
    return MeasuredTable(path, rows[:, :2], rows[:, 2:4], further)
