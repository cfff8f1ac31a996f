"""``tolerance.json``: the table of corners of a written mask."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from metafab.core.storage.files import read_json, write_json
from metafab.tolerance.table import ToleranceRow, ToleranceTable

KIND = "metafab tolerance"
FORMAT = 1


def save_tolerance(table: ToleranceTable, path: Path, *, mask_sha256: str) -> None:
    """Write the table with the hash of the mask that it is of; what is not a number becomes null."""
    write_json(path, {"kind": KIND, "format_version": FORMAT, "mask_sha256": mask_sha256, **tolerance_figures(table)})


def tolerance_figures(table: ToleranceTable) -> dict[str, Any]:
    """The table as it stands in a summary and in the file."""
    return {
        "depth_m": table.depth_m,
        "error": table.error,
        "block_sites": table.block_sites,
        "nominal": table.nominal,
        "rows": table.rows,
    }


def load_tolerance(path: Path) -> tuple[ToleranceTable, str] | None:
    """The table and the hash of its mask; None where there is none, or one that is not ours."""
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
    """A row whose numbers stand in JSON as null (NaN) or "inf"."""
    known: dict[str, Any] = {key: math.nan if value is None else value for key, value in entry.items()}
    known |= {key: float(value) for key, value in known.items() if value in ("inf", "-inf")}
    return ToleranceRow(**known)
