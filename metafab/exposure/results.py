"""Results of an exposure: figures of printed sizes, doses and drawn pillars; ``exposure.json``."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import Float32Array, FloatArray
from metafab.core.errors import InputError
from metafab.core.storage.files import read_json, write_json
from metafab.core.storage.tables import optional, typed
from metafab.exposure.prediction import SizeMap, WindowPoint
from metafab.layout import PillarMap

Correction = Literal["none", "dose", "shape"]
KIND = "metafab exposure"
FORMAT = 1


@dataclass(frozen=True)
class SampledPillar:
    """Figures of one pillar; doses relative to the base dose, energies to the clearing energy.

    Energies at edges are the mean over both edges.
    """

    x_um: float
    y_um: float
    width_nm: float
    length_nm: float
    dose: float
    energy_centre: float
    energy_edge_x: float
    energy_edge_y: float
    printed_width_nm: float
    printed_length_nm: float
    printed_corner_radius_nm: float


@dataclass(frozen=True)
class Walls:
    """Walls of the resist by its contrast, over a sample of the pillars; all other figures hold at half the height."""

    foot_bias_nm: float  #: Mean of printed less wanted size where the height vanishes.
    top_bias_nm: float  #: Mean of printed less wanted size where the height is whole.
    low_share: float  #: Share of the pillars whose height is nowhere whole.


@dataclass(frozen=True)
class ExposureFigures:
    """Figures of an exposure; those of sizes are NaN if no pillar prints."""

    pillars: int  #: Number of pillars.
    #: Rms of printed less wanted size over widths and lengths. The wanted sizes are those of the mask before
    #: correction.
    cd_error_rms_nm: float
    cd_error_max_nm: float  #: Largest magnitude of printed less wanted size.
    cd_bias_nm: float  #: Mean of printed less wanted size.
    unprinted: int  #: Pillars that do not print.
    dose_min: float  #: Smallest dose relative to the base dose.
    dose_max: float  #: Largest dose.
    classes: int  #: Number of distinct doses.
    latitude_nm_per_percent: float  #: Mean change of the printed size for 1 % of dose.
    corner_radius_nm: float  #: Mean radius of printed corners of random pillars.
    corner_radius_rms_nm: float  #: Rms deviation of the radii from their mean.
    base_over_clearing_dose: float  #: Base dose over the clearing dose of a large pad.
    #: Bound of the error of an energy over the clearing energy: four times the largest difference from a direct sum,
    #: over all pillars in reach, at six random pillars of the first lens.
    error: float
    rounds: int  #: Rounds of the correction; 0 without one.
    walls: Walls | None = optional()  #: Foot and top of the resist; None without a contrast.
    continuous_rms_nm: float | None = optional()  #: Rms size error before doses are rounded to classes, if they are.
    continuous_max_nm: float | None = optional()  #: Largest magnitude, likewise.

    def require_printed(self, name: str, key: str) -> None:
        """Refuse an exposure in which no pillar prints: InputError for ``key``, the base dose, of ``name``."""
        if self.unprinted == self.pillars:
            got = f"{self.base_over_clearing_dose:.3g}, at which no pillar prints"
            remedy = "leave it out for the dose to size"
            raise InputError.single(name, key, "a dose at which pillars print", got, remedy)


@dataclass(frozen=True)
class SizeErrors:
    """Printed less wanted sizes of all pillars."""

    figures: ExposureFigures  #: Summary.
    #: Shape (n,), number of widths and lengths in each bin of ``cd_edges_nm``; the first and the last bin hold all
    #: errors beyond them.
    cd_histogram: FloatArray
    cd_edges_nm: FloatArray  #: Shape (n + 1,), ascending.
    size_map: SizeMap  #: Mean errors over the lens.
    window: tuple[WindowPoint, ...]  #: Errors at changed doses.

    @classmethod
    def of(cls, exposure: Exposure) -> SizeErrors:
        """Size errors of an exposure, without its arrays over all pillars."""
        return cls(**{item.name: getattr(exposure, item.name) for item in fields(cls)})


@dataclass(frozen=True)
class Exposure(SizeErrors):
    """Result of an exposure."""

    drawn: PillarMap  #: The pillars to draw: those of the mask, or corrected shapes.
    #: Shape (n_y, n_x) of the lattice, relative to the base dose; equal everywhere without correction.
    dose: Float32Array
    #: Shape (n_y, n_x) of the lattice, index into ``class_dose``; None for continuous or equal doses.
    dose_class: NDArray[np.uint8] | None
    class_dose: FloatArray  #: Shape (classes,), ascending, without the dose of the lens.
    samples: tuple[SampledPillar, ...]  #: Random pillars.
    #: Shape (2, n_y, n_x), of width and length; -inf where a pillar does not print. None unless ``keep_sizes``.
    printed_less_drawn_nm: Float32Array | None


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
