"""Jobs and steps beside goal and floor: processor time, error, and the time of the least work by the plainest code.

``seconds`` is processor time of all processes, that of steps on one core. ``wall_seconds`` is the clock's on all cores:
of commands, of the steps of ``metafab run`` with compiled kernels, of images in a warm process, and of a film's frame
the median. ``goal_s`` is the goal by the clock on two quiet cores, ``peer`` the room that runs the next peer. The
floor, measured in the same process:

- ``library``: the solver alone, on as many random sizes as were solved;
- ``layout``: zeros of as many bytes as the mask files hold, written;
- ``drc``: the mask files, read;
- ``psf``: each pillar's t looked up and added up once a polarisation, and one matrix Fourier transform of the blocks
  for each window;
- ``capture``: one transform and its inverse of the frame for each object and polarisation;
- ``decode``: the transforms of both images, of each basis image, and of each layer's sharp images;
- a pillar, a hundred pillars: their matrix products and linear systems;
- an image, a map or a frame: the transforms of both images;
- commands: those of the steps, or a Python that starts and ends.

``phase``, ``study``, ``merit`` and ``report`` have no floor that is worth its name.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.cell.algebra import algebra_s, least_seconds
from benchmarks.cell.cell import many, paper_cell
from benchmarks.decode.decode import optics_of
from benchmarks.pipeline.commands import REPOSITORY, Finished, finished
from benchmarks.pipeline.least_work import passes_s, read_s, solver_s, start_s, transform_s, window_s, written_s
from metafab import camera, decode, optics
from metafab.cell import CellNumerics, CellResponse, solve
from metafab.core.parallel.measure import measured
from metafab.core.parallel.work import Work
from metafab.decode import VideoDecoder
from metafab.run import STEPS, run
from metafab.spec import Design, load_design
from metafab.steps import RunSummary
from metafab.steps.job import Job, Step

LAYOUTS = REPOSITORY / "layouts"
SMALL, PAPER, OUTDOOR = "helix_small", "helix_2mm", "helix_outdoor"
#: Seconds by the clock that a job is to take, two quiet cores.
GOALS_S = {
    "first command": 20.0,
    f"{SMALL}: whole": 6.0,
    f"{SMALL}: library": 3.0,
    f"{PAPER}: whole": 20.0,
    f"{PAPER}: layout": 5.0,
    f"{PAPER}: drc": 1.3,
    f"{PAPER}: psf": 4.0,
    f"{PAPER}: camera": 2.0,
    f"{PAPER}: report": 2.0,
    "one pillar to 0.001": 0.006,
    "one pillar to 0.0001": 0.020,
    "100 pillars in one call, random sizes": 0.35,
    "metafab --help": 0.15,
    "unchanged run": 0.3,
}
#: Rooms whose rows hold the next peer.
PEERS = {
    "library": "grids: benchmark library",
    "layout": "gdstk, KLayout: benchmark layout",
    "drc": "KLayout: benchmark drc",
    "psf": "prysm and others: benchmark psf",
    "pillar": "fmmax and others: benchmark cell",
}
#: Pillars whose median is the time of one.
_PILLARS = 24
#: Rounds of which an image counts the fastest.
_ROUNDS = 10


def rows(quick: bool) -> list[dict[str, Any]]:
    """A row of each job and step; ``error`` is the step's own.

    Args:
        quick: steps of the small lens and few pillars, without the paper's lens, commands and films.
    """
    with TemporaryDirectory() as place:
        folder = Path(place)
        table = steps_of(SMALL, folder)
        whole_s = table[-1]["floor_s"]
        table += [] if quick else steps_of(PAPER, folder)
    table += [*(_pillar(error, 4 if quick else _PILLARS) for error in (1e-3, 1e-4)), *many(quick)]
    if not quick:
        commands, clock_s = _commands(whole_s)
        table += [*commands, *_images()]
        table = [row | {"wall_seconds": clock_s[row["name"]]} if row["name"] in clock_s else row for row in table]
    return [_beside(row) for row in table]


def _beside(row: dict[str, Any]) -> dict[str, Any]:
    """The row with its goal, its ratio to the floor, and its next peer."""
    name, floor_s = row["name"], row.get("floor_s")
    peer = next((room for word, room in PEERS.items() if word in name), None)
    return row | {"goal_s": GOALS_S.get(name), "ratio": row["seconds"] / floor_s if floor_s else None, "peer": peer}


def steps_of(name: str, folder: Path) -> list[dict[str, Any]]:
    """Rows of the design ``layouts/NAME.toml``, on one core, and of the whole run.

    Its library is built on the way, unless ``folder`` holds it.
    """
    design = load_design(LAYOUTS / f"{name}.toml")
    costs: dict[str, tuple[float, float]] = {}
    cell = folder / design.library.name
    is_built = cell.with_suffix(".h5").exists()
    shutil.copy(design.library, cell)
    design = replace(design, library=cell)
    steps = [replace(step, work=_timed(step, costs)) for step in STEPS]
    summary = run(design, folder / name, steps=steps, work=Work(workers=1))
    floors, errors = _floors(design, summary, folder / name), _errors(summary)
    if is_built:
        del floors["library"]
    table = [
        {
            "name": f"{name}: {step}",
            "error": errors.get(step),
            "seconds": seconds,
            "peak_rss_mb": peak_rss_mb,
            "floor_s": floors.get(step),
        }
        for step, (seconds, peak_rss_mb) in costs.items()
    ]
    camera = [row for row in table if row["name"].endswith((": capture", ": decode"))]
    return [*table, _sum(f"{name}: camera", camera, errors["decode"]), _sum(f"{name}: whole", table, errors["decode"])]


def _sum(name: str, parts: list[dict[str, Any]], error: float | None) -> dict[str, Any]:
    return {
        "name": name,
        "error": error,
        "seconds": sum(row["seconds"] for row in parts),
        "peak_rss_mb": max(row["peak_rss_mb"] for row in parts),
        "floor_s": sum(row["floor_s"] or 0.0 for row in parts),
    }


def _pillar(target_error: float, count: int) -> dict[str, Any]:
    """Median time of one certified pillar of the paper's cell, and of its matrix products and linear systems."""
    sizes_nm = np.random.default_rng(1).uniform(100.0, 250.0, (count, 2)).tolist()
    cells, numerics = [paper_cell(*size_nm) for size_nm in sizes_nm], CellNumerics(target_error=target_error)
    solve(cells[0], numerics)
    found: list[tuple[float, CellResponse]] = []
    for cell in cells:
        with measured() as cost:
            answer = solve(cell, numerics)
        found.append((cost.processor_seconds, answer))
    seconds, answer = sorted(found, key=lambda each: each[0])[count // 2]
    error = max(each.error for _, each in found)
    return {
        "name": f"one pillar to {target_error:g}",
        "error": error,
        "seconds": seconds,
        "floor_s": algebra_s([answer]),
    }


def _commands(whole_s: float) -> tuple[list[dict[str, Any]], dict[str, float]]:
    """Rows of commands in a copy of the repository's inputs, and the clock's seconds of each step of both lenses.

    The first command compiles, with the floor ``whole_s``; steps are those of later runs.
    """
    with TemporaryDirectory() as place:
        folder = Path(place)
        for name in ("layouts", "unitcell_lib"):
            shutil.copytree(REPOSITORY / name, folder / name, ignore=shutil.ignore_patterns("*.h5"))
        lens = ("run", str(folder / "layouts" / f"{SMALL}.toml"), "-o", str(folder / "run"), "--json")
        first = finished(*lens, NUMBA_CACHE_DIR=str(folder / "kernels"))
        # Inputs that were copied just before a run are compared by their contents once, and by their times from then.
        finished(*lens)
        again, listed, start = finished(*lens), finished("--help"), start_s()
        (folder / "unitcell_lib" / "sos_800nm.h5").unlink()
        clock_s = _clock(folder, SMALL) | _clock(folder, PAPER)
    depth = json.loads(first.stdout)["decode"]["nmae"]
    table = [
        _command("first command", first, depth, whole_s),
        _command("unchanged run", again, depth, start),
        _command("metafab --help", listed, None, start),
    ]
    return table, clock_s


def _clock(folder: Path, name: str) -> dict[str, float]:
    """Seconds by the clock of the steps and of the whole of ``metafab run``, by the names of their rows."""
    done = finished("run", str(folder / "layouts" / f"{name}.toml"), "-o", str(folder / f"{name}_clock"), "--json")
    _require_done(name, done)
    seconds: dict[str, float] = json.loads(done.stdout)["seconds"]
    parts = seconds | {"camera": seconds["capture"] + seconds["decode"], "whole": done.seconds}
    return {f"{name}: {part}": clock_s for part, clock_s in parts.items()}


def _require_done(name: str, done: Finished) -> None:
    if done.code:
        raise RuntimeError(f"{name}: exit code {done.code}: {done.stderr}")


def _command(name: str, done: Finished, error: float | None, floor_s: float) -> dict[str, Any]:
    _require_done(name, done)
    return {
        "name": name,
        "error": error,
        "seconds": done.processor_seconds,
        "wall_seconds": done.seconds,
        "peak_rss_mb": done.peak_rss_mb,
        "floor_s": floor_s,
    }


def _images() -> list[dict[str, Any]]:
    """Rows of a 4D image, a depth map and a film's frame with a moving car; their judgement is not timed."""
    (frame, *_), decoder = _photographed(PAPER)
    image, unjudged = decoder(frame), replace(frame, truth=None)
    decoders = {"4D image": partial(decoder, unjudged), "depth map": partial(decoder.depth_map, unjudged)}
    table = [
        {
            "name": name,
            "error": image.nmae,
            "seconds": least_seconds(work),
            "wall_seconds": least_seconds(work, _ROUNDS, time.perf_counter),
        }
        for name, work in decoders.items()
    ]
    frames, decoder = _photographed(OUTDOOR)
    judged, timed = VideoDecoder(decoder), VideoDecoder(decoder)
    errors = [judged(each).nmae for each in frames]
    timed(replace(frames[0], truth=None))
    clock_s = []
    with measured() as cost:
        for each in frames[1:]:
            begun = time.perf_counter()
            timed(replace(each, truth=None))
            clock_s.append(time.perf_counter() - begun)
    seconds, error = cost.processor_seconds / len(frames[1:]), float(np.mean([each for each in errors if each]))
    film = {"name": "frame of a film with motion", "error": error, "seconds": seconds}
    table.append(film | {"wall_seconds": float(np.median(clock_s))})
    floor_s = 2.0 * transform_s(*image.depth_m.shape)
    return [{**row, "floor_s": floor_s} for row in table]


def _photographed(name: str) -> tuple[list[camera.RawFrame], decode.Decoder]:
    """Frames of a design's scene by its target phases, and their decoder."""
    design = load_design(LAYOUTS / f"{name}.toml")
    source, imaging, depth_m = optics_of(design)
    pair = optics.psf(source, imaging, depth_m)
    assert design.scene is not None  # these lenses have one
    frames = list(camera.film(design.scene, pair))
    decoder = decode.Decoder.of(pair, frames[0].frame.shape, frames[0].origin_um, frames[0].x_window)
    assert decoder is not None  # the frame holds both images
    return frames, decoder


def _timed(step: Step, costs: dict[str, tuple[float, float]]) -> Callable[[Job], Any]:
    def work(job: Job) -> Any:
        with measured() as cost:
            figures = step.work(job)
        costs[step.name] = (cost.processor_seconds, cost.peak_rss_mb)
        return figures

    return work


def _errors(summary: RunSummary) -> dict[str, float | None]:
    library, layout, psf, decode = summary.library, summary.layout, summary.psf, summary.decode
    return {
        "library": None if library is None else library.max_error,
        "layout": None if layout is None else layout.phase_rms_error_rad,
        "psf": None if psf is None else max(psf.error),
        "decode": None if decode is None else decode.nmae,
    }


def _floors(design: Design, summary: RunSummary, folder: Path) -> dict[str, float]:
    library, layout, psf, decode, scene = summary.library, summary.layout, summary.psf, summary.decode, design.scene
    assert library is not None
    assert layout is not None
    assert psf is not None
    assert decode is not None
    assert scene is not None
    masks = [folder / file.name for file in layout.files]
    directions = 1 + int(np.prod(design.verify.field_points))
    windows = 2 * (directions * psf.depths + len(design.verify.depths_m))
    rows_px, columns_px = scene.field_px
    step = decode.step_px or 1
    return {
        "library": library.points_solved * solver_s(design.unit_cell),
        "layout": written_s(folder / "floor", sum(path.stat().st_size for path in masks)),
        "drc": read_s(masks),
        "psf": passes_s(layout.pillars) + windows * window_s(round(psf.blocks or 1), design.verify.window_px),
        "capture": 4 * len(scene.objects) * transform_s(rows_px, 2 * columns_px),
        "decode": (2 + 2 * (decode.basis_images or 0)) * transform_s(rows_px // step, columns_px // step)
        + 2 * (decode.layers or 1) * transform_s(rows_px, columns_px),
    }
