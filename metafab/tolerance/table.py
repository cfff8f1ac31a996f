"""Tolerance table of a written mask, and its file ``tolerance.json``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.storage.files import read_json, write_json

KIND = "metafab tolerance"
FORMAT = 1


@dataclass(frozen=True)
class ToleranceRow:
    """One corner compared with the nominal mask; each figure is the worst of both polarisations and all depths.

    For random faults, ``change``, ``turn_deg`` and ``depth_error_m`` are the rms over the draws, the others their mean.

    Attributes:
        corner: name of the corner or fault.
        change: relative L2 change of the irradiance.
        peak_ratio: smallest peak over the nominal peak.
        efficiency: smallest share of the power in the window.
        efficiency_change: signed change of that share of the largest modulus.
        extinction_ratio: smallest ratio of wanted over unwanted light in the window of x.
        turn_deg: signed turn of the main lobe of PSF_x of the largest modulus.
        depth_error_m: signed error of the decoded depth of the largest modulus, over finite depths; NaN where the pair
            does not turn or no trial depth agrees.
        relative_error: error of the changes over the changes, from the corner's amplitudes or the number of draws.
        draws: number of random masks; 0 for a corner of the cell.
        solved: number of cells solved for the row.
        below_error: whether the change of the PSFs is within their error, so that the row is an upper bound.
    """

    corner: str
    change: float
    peak_ratio: float
    efficiency: float
    efficiency_change: float
    extinction_ratio: float
    turn_deg: float
    depth_error_m: float
    relative_error: float
    draws: int = 0
    solved: int = 0
    below_error: bool = False


@dataclass(frozen=True)
class ToleranceTable:
    """All corners of a mask.

    Attributes:
        nominal: the mask without faults.
        rows: corners and random faults.
        depth_m: shape (n_depth,), object depths.
        error: relative L2 error of any PSF; smaller changes are not significant.
        block_sites: sites along a side of a pupil block.
    """

    nominal: ToleranceRow
    rows: tuple[ToleranceRow, ...]
    depth_m: FloatArray
    error: float
    block_sites: int


def save_tolerance(table: ToleranceTable, path: Path, *, mask_sha256: str) -> None:
    """Write the table with the hash of its mask; NaN becomes null."""
    write_json(path, {"kind": KIND, "format_version": FORMAT, "mask_sha256": mask_sha256, **tolerance_figures(table)})


def tolerance_figures(table: ToleranceTable) -> dict[str, Any]:
    """Return the entries of the table by their names in summaries and files."""
    return {
        "depth_m": table.depth_m,
        "error": table.error,
        "block_sites": table.block_sites,
        "nominal": table.nominal,
        "rows": table.rows,
    }


def load_tolerance(path: Path) -> tuple[ToleranceTable, str] | None:
    """Return the table and the hash of its mask; None if the file is missing, damaged or of another kind."""
    return read_json(path, KIND, FORMAT, _table)


def _table(content: dict[str, Any]) -> tuple[ToleranceTable, str]:
    table = ToleranceTable(
        nominal=_row(content["nominal"]),
        rows=tuple(_row(row) for row in content["rows"]),
        depth_m=np.array(content["depth_m"], dtype=np.float64),
        error=float(content["error"]),
        block_sites=int(content["block_sites"]),
    )
    return table, str(content["mask_sha256"])


def _row(entry: dict[str, Any]) -> ToleranceRow:
    """A row of JSON, in which NaN is null and infinity is a text."""
    values: dict[str, Any] = {key: math.nan if value is None else value for key, value in entry.items()}
    values |= {key: float(value) for key, value in values.items() if value in ("inf", "-inf")}
    return ToleranceRow(**values)
