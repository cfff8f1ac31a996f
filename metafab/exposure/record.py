"""Record of an exposure for the report: size errors before and after the correction; ``exposure.json``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from metafab.core.conventions import FloatArray
from metafab.core.storage.files import read_json, write_json
from metafab.core.storage.tables import typed
from metafab.exposure.expose import Correction, Exposure, ExposureFigures
from metafab.exposure.prediction import SizeMap, WindowPoint

KIND = "metafab exposure"
FORMAT = 1


@dataclass(frozen=True)
class SizeErrors:
    """Printed less wanted sizes of all pillars.

    Attributes:
        figures: summary.
        cd_histogram: shape (n,), number of widths and lengths in each bin of ``cd_edges_nm``; the first and the last
            bin hold all errors beyond them.
        cd_edges_nm: shape (n + 1,), ascending.
        size_map: mean errors over the lens.
        window: errors at changed doses.
    """

    figures: ExposureFigures
    cd_histogram: FloatArray
    cd_edges_nm: FloatArray
    size_map: SizeMap
    window: tuple[WindowPoint, ...]

    @classmethod
    def of(cls, exposure: Exposure) -> SizeErrors:
        """Size errors of an exposure, without its arrays over all pillars."""
        histogram = exposure.cd_histogram.astype("float64")
        return cls(exposure.figures, histogram, exposure.cd_edges_nm, exposure.size_map, exposure.window)


@dataclass(frozen=True)
class ExposureRecord:
    """Exposure of a written mask, before and after the correction.

    Attributes:
        mask_sha256: hash of the mask file.
        psf_source: source of the beam's point-spread function.
        correction: kind of the correction.
        plain: size errors with one dose.
        corrected: size errors after the correction; None without one.
    """

    mask_sha256: str
    psf_source: str
    correction: Correction
    plain: SizeErrors
    corrected: SizeErrors | None


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
