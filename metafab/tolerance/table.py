"""File of the tolerance table of a written mask, ``tolerance.json``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from metafab.core.figures import ToleranceTable
from metafab.core.storage.files import read_json, write_json
from metafab.core.storage.tables import typed

KIND = "metafab tolerance"
FORMAT = 1


def save_tolerance(table: ToleranceTable, path: Path, *, mask_sha256: str) -> None:
    """Write the table with the hash of its mask; NaN becomes null."""
    write_json(path, {"kind": KIND, "format_version": FORMAT, "mask_sha256": mask_sha256, **vars(table)})


def load_tolerance(path: Path) -> tuple[ToleranceTable, str] | None:
    """Return the table and the hash of its mask; None if the file is missing, damaged or of another kind."""
    return read_json(path, KIND, FORMAT, _table)


def _table(content: dict[str, Any]) -> tuple[ToleranceTable, str]:
    return typed(ToleranceTable, content), str(content["mask_sha256"])
