"""Diffraction orders of a mask whose pattern repeats, and the error of the local-period approximation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from metafab.core.conventions import POLARISATIONS
from metafab.core.errors import InputError, SolverError
from metafab.core.figures import OrdersFigures
from metafab.core.storage.files import file_sha256, read_json, write_json
from metafab.core.storage.tables import optional, typed
from metafab.spec import Design
from metafab.spec.terms import Lens, Radial, SplitLens
from metafab.steps.job import Job, Step, in_folder, no_mask
from metafab.steps.layout import mask_paths
from metafab.steps.library import open_library
from metafab.steps.optics.sources import mask_source

#: Numerical aperture for collimated light from which a run solves rows of a lens: a turn of its phase at the rim takes
#: two to four pillars.
_STEEP = 0.5
#: File of the orders, and its kind.
_FILE, _KIND = "orders.json", "metafab orders"


@dataclass(frozen=True)
class CouplingFigures:
    """Error of the local-period approximation, from full-wave simulations of rows of the mask."""

    coupling_error: float  #: Relative L2 error of the field.
    efficiency_ratio: float  #: Power in the wanted order relative to that of the stitched library.
    rows: int  #: Simulated rows, or repeats of the pattern.
    solvers: tuple[str, ...]  #: Names of the solvers.
    #: That ratio of x and of y polarised light, where the pattern repeats.
    polarised_ratio: tuple[float, ...] | None = optional()


def recorded_coupling(job: Job) -> CouplingFigures | None:
    """Figures of rows by ``metafab coupling``, or of the step ``orders``, for a mask of this run; None without any."""
    if not any((job.folder / name).is_file() for name in ("coupling.json", _FILE)):
        return None
    from metafab.fullwave.coupling import find_coupling

    if coupling := find_coupling(job.folder, mask_paths(job)):
        solvers = tuple(sorted({row.solver for row in coupling.rows}))
        return CouplingFigures(coupling.coupling_error, coupling.efficiency_ratio, len(coupling.rows), solvers)
    of_masks = {file_sha256(path) for path in mask_paths(job) if path.is_file()}
    return read_json(job.folder / _FILE, _KIND, 1, lambda table: _of_orders(table, of_masks))


def _of_orders(table: dict[str, Any], of_masks: set[str]) -> CouplingFigures | None:
    figures = typed(OrdersFigures, table["figures"])
    if table["mask_sha256"] not in of_masks or figures.windows is None or figures.coupling_error is None:
        return None
    shares = np.array([figures.wanted(p) for p in POLARISATIONS])
    ratio, mean = shares[:, 0] / shares[:, 2], float(shares[:, 0].sum() / shares[:, 2].sum())
    return CouplingFigures(figures.coupling_error, mean, figures.windows, ("rcwa",), tuple(ratio.tolist()))


def _orders(job: Job) -> OrdersFigures:
    path = mask_paths(job)[-1]
    try:
        if _focuses(job.design):
            return _rings(job, path)
        figures = _repeats(job, path)
    except InputError as error:
        figures = OrdersFigures(reason=f"not solved ({error.faults[0]})")
    except SolverError as error:
        figures = OrdersFigures(reason=f"not solved ({error})")
    content = {"kind": _KIND, "format_version": 1, "mask_sha256": file_sha256(path), "figures": figures}
    write_json(job.folder / _FILE, content)
    return figures


def _repeats(job: Job, path: Path) -> OrdersFigures:
    from metafab.fullwave.repeats import measure_orders

    with job.work.processes() as executor:
        pillars, library = mask_source(job, path).pillars, open_library(job)
        return measure_orders(pillars, library, executor=executor, progress=job.work.progress)


def _rings(job: Job, path: Path) -> OrdersFigures:
    """Rows of a steep lens instead of repeats, kept as those of ``metafab coupling``; InputError if it has none."""
    from metafab.fullwave.coupling import measure_rings, save_coupling

    pillars, radius_um = mask_source(job, path).pillars, 0.5 * job.design.device.aperture_um
    found = measure_rings(pillars, open_library(job), radius_um, file_sha256(path), job.work.progress)
    save_coupling(found, job.folder / _FILE)
    return OrdersFigures(
        windows=len(found.rows), coupling_error=found.coupling_error, efficiency_ratio=found.efficiency_ratio
    )


def _focuses(design: Design) -> bool:
    return any(isinstance(term, Lens | Radial | SplitLens) for term in design.phase)


def _has_no_orders(design: Design) -> str | None:
    half_mm = 0.5e-3 * design.device.aperture_um
    is_steep = half_mm / math.hypot(half_mm, design.device.focal_length_mm) >= _STEEP
    if (reason := no_mask(design)) or not _focuses(design) or is_steep:
        return reason
    return "the design focuses light: its pillars do not repeat"


ORDERS = Step(
    name="orders",
    rooms=("mask", "cell", "library", "fullwave"),
    after=("library", "layout"),
    inputs=lambda d: d.mask.bias_nm,
    outputs=in_folder(_FILE),
    work=_orders,
    figures=OrdersFigures,
    not_needed=_has_no_orders,
)
