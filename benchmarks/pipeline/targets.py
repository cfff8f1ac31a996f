"""Error against time from design to depth: the small lens, with numerical targets tightened from 1e-2 to 1e-4.

One mask is photographed by the exact camera (:mod:`metafab.camera.exact`) and decoded with PSFs computed from the same
mask at looser and looser targets. Series:

- ``equal``: library, PSFs and interpolation over the field have one target;
- ``library``: that of the library alone is loosened;
- ``by depth``: ``verify.target_depth_error`` allots the errors, and the library keeps its own target.

``error`` is what the numerics do to depth: the mean over objects and frames of the relative change of an object's depth
against the finest PSFs, in frames with a thousand times the scene's light. ``object_error`` is the whole error at the
scene's own light, noise and decoder included. ``allowed`` is the error that ``by depth`` leaves to the numerics.
Seconds are processor time of the library and of the PSFs in one process.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from metafab import camera, decode
from metafab.camera import RawFrame
from metafab.core.conventions import FloatArray
from metafab.core.parallel.measure import Cost, measured
from metafab.core.parallel.work import Work
from metafab.library import build
from metafab.library.store import save
from metafab.optics import Psf
from metafab.optics.depth_target import NUMERICAL_SHARE, field_points, with_depth_target
from metafab.spec import Design, load_design
from metafab.steps import Job, calibration, write_layout
from metafab.steps.optics import WrittenLens, scene_pair

SMALL = Path(__file__).parents[2] / "layouts" / "helix_small.toml"
TARGETS, QUICK = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2), (1e-3, 1e-2)
DEPTH_TARGETS, QUICK_DEPTH = (1e-3, 3e-3, 1e-2, 3e-2), (3e-3, 3e-2)
#: Seeds of the frames, and their light over that of the scene where noise is left out.
_SEEDS, _BRIGHT = (1, 2, 3, 4), 1e3


@dataclass(frozen=True)
class Bench:
    """One mask, its photographs, and what the finest PSFs decode from them."""

    design: Design  #: The lens.
    mask: Path  #: Its mask file.
    frames: tuple[RawFrame, ...]  #: Photographs at the scene's light.
    bright: tuple[RawFrame, ...]  #: Photographs without visible noise.
    finest: FloatArray  #: Depth errors of the bright ones by the finest PSFs, see :func:`object_errors`.

    def row(self, name: str, series: str, pair: Psf, costs: Sequence[Cost], **columns: Any) -> dict[str, Any]:
        """Row of a PSF pair."""
        seconds = [cost.processor_seconds for cost in costs]
        return {
            "name": name,
            "series": series,
            "error": float(np.abs(object_errors(pair, self.bright) - self.finest).mean()),
            "seconds": sum(seconds),
            "peak_rss_mb": max(cost.peak_rss_mb for cost in costs),
            "object_error": float(np.abs(object_errors(pair, self.frames)).mean()),
            "library_s": seconds[0],
            "psf_s": seconds[1],
            "depths": pair.depth_m.size,
            "directions": 1 if pair.field is None else pair.field.tangent_x.size * pair.field.tangent_y.size,
            **columns,
        }


def rows(quick: bool) -> list[dict[str, Any]]:
    """Rows of the three series.

    Args:
        quick: fewer targets, and a reference of 1e-3.
    """
    targets, depth_targets = (QUICK, QUICK_DEPTH) if quick else (TARGETS, DEPTH_TARGETS)
    with TemporaryDirectory() as place:
        folder, design = Path(place), load_design(SMALL)
        cell = folder / design.library.name
        shutil.copy(design.library, cell)
        design = replace(design, library=cell)
        _library(design, targets[-1], folder)  # what is compiled stays out of the times
        libraries = {
            error: _library(design, error, folder) for error in (design.unit_cell.sweep.target_error, *targets)
        }
        own, mask = libraries[design.unit_cell.sweep.target_error], folder / "mask" / "layout.oas"
        write_layout(Job(replace(design, library=own[0]), mask.parent, Work(workers=1)))
        library, finest = libraries[targets[0]], _equal(design, targets[0])
        pair, cost = _calibrated(finest, library[0], mask)
        bench = _bench(finest, library[0], mask, pair)
        table = [bench.row(f"equal targets {targets[0]:g}", "equal", pair, (library[1], cost))]
        for error in targets[1:]:
            made = _calibrated(_equal(design, error), libraries[error][0], mask)
            table.append(bench.row(f"equal targets {error:g}", "equal", made[0], (libraries[error][1], made[1])))
        loosest = libraries[targets[-1]]
        made = _calibrated(finest, loosest[0], mask)
        table.append(bench.row(f"library alone {targets[-1]:g}", "library", made[0], (loosest[1], made[1])))
        for error in depth_targets:
            allotted = with_depth_target(replace(design, verify=replace(design.verify, target_depth_error=error)))
            made = _calibrated(allotted, own[0], mask)
            row = bench.row(f"depth error {error:g}", "by depth", made[0], (own[1], made[1]))
            table.append(row | {"allowed": NUMERICAL_SHARE * error, "psf_target": allotted.verify.target_error})
        return table


def object_errors(pair: Psf, frames: Sequence[RawFrame]) -> FloatArray:
    """Relative depth error of every object in every frame; an object that was not found counts as 1."""
    numbers = sorted(
        {int(n) for frame in frames if frame.truth is not None for n in np.unique(frame.truth.label)} - {0}
    )
    found = [decode.object_errors(decode.decode(frame, pair), frame) for frame in frames]
    return np.array([[errors.get(number, 1.0) for number in numbers] for errors in found])


def _equal(design: Design, error: float) -> Design:
    """The design with one target for the PSFs and the field."""
    points = field_points(design, 0.5 * error)
    assert points is not None  # the field of this lens is narrow
    return replace(design, verify=replace(design.verify, target_error=error, field_points=points))


def _library(design: Design, error: float, folder: Path) -> tuple[Path, Cost]:
    """File of a library built to a target, and its cost."""
    path = folder / f"library_{error:g}.h5"
    with measured() as cost:
        save(build(design.unit_cell, target_error=error), path)
    return path, cost


def _calibrated(design: Design, library: Path, mask: Path) -> tuple[Psf, Cost]:
    """PSFs of the mask for the decoder, and their cost."""
    with measured() as cost:
        pair = calibration(Job(replace(design, library=library), mask.parent, Work(workers=1)), WrittenLens(mask))
    return pair, cost


def _bench(design: Design, library: Path, mask: Path, finest: Psf) -> Bench:
    """Photograph the scene of the design through the mask."""
    scene = design.scene
    assert scene is not None  # the small lens has one
    exact = scene_pair(Job(replace(design, library=library), mask.parent, Work(workers=1)), WrittenLens(mask), scene)
    bright = replace(scene, photons_per_pixel=_BRIGHT * scene.photons_per_pixel)
    frames, calm = (tuple(camera.draws(each, exact, _SEEDS)) for each in (scene, bright))
    return Bench(design, mask, frames, calm, object_errors(finest, calm))
