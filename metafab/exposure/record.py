"""Record of an exposure for the report: size errors before and after the correction; ``exposure.json``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from metafab.core.storage.files import read_json, write_json
from metafab.core.storage.tables import typed
from metafab.exposure.expose import Correction, SizeErrors

KIND = "metafab exposure"
FORMAT = 1


@dataclass(frozen=True)
class ExposureRecord:
    """Exposure of a written mask, before and after the correction."""

    mask_sha256: str  #: Hash of the mask file.
    psf_source: str  #: Source of the beam's point-spread function.
    correction: Correction  #: Kind of the correction.
    plain: SizeErrors  #: Size errors with one dose.
    corrected: SizeErrors | None  #: Size errors after the correction; None without one.


def save_record(record: ExposureRecord, path: Path) -> None:
    """Write ``exposure.json``."""
    write_json(path, {"kind": KIND, "format_version": FORMAT, **vars(record)})


def load_record(path: Path) -> ExposureRecord | None:
    """Read ``exposure.json``; None where it is missing, damaged, of another kind or of a newer format."""
    return read_json(path, KIND, FORMAT, _record)


def _record(table: dict[str, Any]) -> ExposureRecord:
    record = typed(ExposureRecord, table)
    for part in (record.plain, record.corrected):
        if part is None:
            continue
        sound = part.size_map.bias_nm.ndim == 2 and part.cd_histogram.shape == (part.cd_edges_nm.size - 1,)
        if not sound or not part.window:
            raise ValueError("size errors of unequal shapes")
    return record
