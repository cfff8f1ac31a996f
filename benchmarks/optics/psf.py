"""PSF benchmarks: error against the direct sum over every pillar, time and memory against goals, and other libraries.

There are four tables: true errors on and off the axis; cost of each part with its goal (``goal_s``, ``goal_mb``); a
filter, and a stack over the field; and other libraries (``psf_comparison.py``) in the interpreters of
METAFAB_PEERS_PYTHON.
"""

from __future__ import annotations

import math
import resource
import time
import tracemalloc
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.optics.direct_sum import direct_irradiance
from benchmarks.optics.psf_basis import PsfBasis
from benchmarks.optics.psf_comparison import APERTURES_UM, peer_rows
from benchmarks.optics.psf_lens import lens_design, lens_field
from metafab.core.conventions import FloatArray
from metafab.core.parallel.work import Work
from metafab.optics import Imaging, PsfNumerics, WrittenField, psf, relative_l2
from metafab.optics.geometry.imaging import Tangent
from metafab.optics.propagation.blocks import reduce_to_target
from metafab.optics.propagation.image import Window
from metafab.optics.propagation.kernel import WindowKernel
from metafab.optics.propagation.pupil import Pupil, reduce_field

WINDOW_PX, REFERENCE_POINTS = 64, 10
ONE_THREAD = Work(workers=1)
TARGETS = (1e-2, 1e-3, 1e-4)
#: Half the field of view through the aperture stop of the paper.
EDGE = math.tan(math.radians(3.6))
DIRECTIONS = {
    "axis": (0.0, 0.0),
    "+3.6 degrees in x and y": (EDGE, EDGE),
    "-3.6 degrees in x and y": (-EDGE, -EDGE),
}
#: Goals of one window from prepared blocks.
WINDOW_GOAL_S = {"axis": 4e-3}
WINDOW_GOAL_OFF_AXIS_S = 20e-3
STACK_GOAL_S = {1e-3: 0.15, 1e-4: 1.0}
BAND_GOAL_S = {1e-2: 0.05, 1e-3: 0.25}
PASS_GOAL_S, PASS_GOAL_MB = 0.15, 300.0
LIBRARY_GOAL_S, LIBRARY_GOAL_RANK = 10.0, 90
REPEATS = 5

Result = TypeVar("Result")


def rows(quick: bool) -> list[dict[str, Any]]:
    """Return all tables for the 2 mm lens; if ``quick``, for a tenth of it, at one direction and target.

    Times of rows with ``goal_s`` are processor times on one thread, the best of several.
    """
    design = lens_design(200.0 if quick else 2000.0)
    imaging = Imaging.of(design)
    source = lens_field(design, imaging)
    near = design.verify.depths_m[0]
    depths = np.array([near, 1.2 * near, 2.4 * near])
    psf(source, imaging, [near], PsfNumerics(window_px=16))  # compiles
    table = []
    for name, tangent in list(DIRECTIONS.items())[: 1 if quick else None]:
        table += _errors(source, imaging, depths, name, tangent, TARGETS[1:2] if quick else TARGETS)
    stack = near / np.linspace(1.0, 1.0 / 2.4, 21)
    parts = [
        _parts(source, imaging, stack, name, target)
        for name in (("axis",) if quick else DIRECTIONS)
        for target in (TARGETS[1:2] if quick else TARGETS)
    ]
    table += [row for part in parts for row in part]
    table += _bands(source, imaging, depths[1])
    table += _library(source, imaging, stack, 3 if quick else 9)
    if quick:
        return table + peer_rows([], APERTURES_UM[:1], limit_s=0.0)
    return table + peer_rows(_own_results(table))


def _errors(
    source: WrittenField,
    imaging: Imaging,
    depths_m: FloatArray,
    name: str,
    tangent: Tangent,
    targets: tuple[float, ...],
) -> list[dict[str, Any]]:
    """True error of either polarisation at each target, at the worst depth; ``stated`` is the largest stated error."""
    truth = [_truth(source, imaging, depths_m, tangent, p) for p in (0, 1)]
    step = WINDOW_PX // REFERENCE_POINTS
    places = slice(0, step * REFERENCE_POINTS, step)
    table = []
    for target in targets:
        cost, result = _timed(
            lambda target=target: psf(
                source, imaging, depths_m, PsfNumerics(target_error=target), tangent=tangent, work=ONE_THREAD
            ),
            1,
        )
        errors = [
            [relative_l2(image[places, places], true) for image, true in zip(*pair, strict=True)]
            for pair in zip(result.psf, truth, strict=True)
        ]
        table.append(
            {
                **cost,
                "name": f"pair at {len(depths_m)} depths, {name}, target {target:g}",
                "series": f"metafab, pair at {len(depths_m)} depths",
                "error": float(np.max(errors)),
                "error_x": float(np.max(errors[0])),
                "error_y": float(np.max(errors[1])),
                "stated": float(result.error.max()),
                "blocks": result.details.blocks,
                "target": target,
                "direction": name,
            }
        )
    return table


def _truth(
    source: WrittenField, imaging: Imaging, depths_m: FloatArray, tangent: Tangent, polarisation: int
) -> FloatArray:
    """Direct sum at every sixth point of the window along either side, shape (n_depth, 10, 10)."""
    axis = (np.arange(REFERENCE_POINTS) * (WINDOW_PX // REFERENCE_POINTS) - WINDOW_PX // 2) * imaging.pixel_um
    centre = imaging.image_point_um(polarisation, tangent)
    x, y = np.meshgrid(centre[0] + axis, centre[1] + axis)
    truth = direct_irradiance(source, imaging, depths_m, tangent, x.ravel(), y.ravel(), polarisation)
    return truth.reshape(len(depths_m), REFERENCE_POINTS, REFERENCE_POINTS)


def _parts(
    source: WrittenField, imaging: Imaging, stack_m: FloatArray, name: str, target: float
) -> list[dict[str, Any]]:
    """Costs for one polarisation: pass over the pillars, one window, 21 depths, with the blocks of the pair."""
    tangent, window = DIRECTIONS[name], _window(imaging, target)
    with threadpool_limits(1, "blas"):
        pyramid = _blocks(source, [window], stack_m, tangent, target)
        carrier = pyramid[0].carrier
        tracemalloc.start()
        over_pillars, _ = _timed(lambda: reduce_field(source, [carrier], imaging.wavenumber, ONE_THREAD), 1)
        traced_mb = tracemalloc.get_traced_memory()[1] / 1e6
        tracemalloc.stop()
        over_pillars, _ = _timed(lambda: reduce_field(source, [carrier], imaging.wavenumber, ONE_THREAD))
        middle = stack_m[len(stack_m) // 2 :][:1]
        one, (_, error) = _timed(lambda: window.irradiance(pyramid, 0, tangent, middle))
        bare, _ = _timed(lambda: window.irradiance(pyramid[:1], 0, tangent, middle, judged="none"))
        first, _ = _timed(lambda: _with_empty_cache(window.irradiance, pyramid[:1], 0, tangent, middle, judged="none"))
        many, (_, errors) = _timed(lambda: window.irradiance(pyramid, 0, tangent, stack_m))
    case = f"{name}, target {target:g}"
    stated, worst = float(error.max()), float(errors.max())
    whole_s = over_pillars["seconds"] + many["seconds"]
    goal_s = (WINDOW_GOAL_S.get(name, WINDOW_GOAL_OFF_AXIS_S)) if target == 1e-3 else None
    table = [
        {
            **over_pillars,
            "name": f"pass over the pillars, {case}",
            "series": "metafab, pass",
            "error": stated,
            "traced_mb": traced_mb,
            "goal_s": PASS_GOAL_S,
            "goal_mb": PASS_GOAL_MB,
        },
        {
            **bare,
            "name": f"one window from blocks, {case}",
            "series": "metafab, one window",
            "error": stated,
            "goal_s": goal_s,
        },
        {
            **first,
            "name": f"one window from blocks with its kernel, {case}",
            "series": "metafab, first window",
            "error": stated,
            "goal_s": goal_s,
        },
        {
            **one,
            "name": f"one window from blocks with its error, {case}",
            "series": "metafab, one window and its error",
            "error": stated,
        },
        {
            **many,
            "name": f"pass and {len(stack_m)} depths with their errors, {case}",
            "series": f"metafab, pass and {len(stack_m)} depths",
            "error": worst,
            "seconds": whole_s,
            "goal_s": STACK_GOAL_S.get(target),
        },
    ]
    seconds = {"window": bare["seconds"], "pass": over_pillars["seconds"], "stack": many["seconds"]}
    table[-1] |= {f"seconds_{part}": value for part, value in seconds.items()} | {"target": target, "direction": name}
    return table


def _with_empty_cache(run: Callable[..., Result], *arguments: Any, **options: Any) -> Result:
    """Call ``run`` without cached kernels."""
    WindowKernel.clear_cache()
    return run(*arguments, **options)


def _window(imaging: Imaging, target: float) -> Window:
    return Window(imaging, WINDOW_PX, min(0.1 * target, 1e-3))


def _blocks(
    source: WrittenField, windows: Sequence[Window], depths_m: FloatArray, tangent: Tangent, target: float
) -> list[Pupil]:
    """Blocks of x polarisation that :func:`psf` takes for these windows, and coarser ones."""
    with ThreadPoolExecutor(1) as pool:
        pyramids, _ = reduce_to_target(
            source, windows, [float(z) for z in depths_m], tangent, None, target, pool, ONE_THREAD
        )
    return pyramids[0]


def _bands(source: WrittenField, imaging: Imaging, depth_m: float) -> list[dict[str, Any]]:
    """Costs of one window of one polarisation over a filter of 10 nm, from prepared blocks."""
    table = []
    for target, goal_s in BAND_GOAL_S.items():
        numerics = PsfNumerics(window_px=WINDOW_PX, target_error=target, filter_fwhm_nm=10.0)
        tangent, window = DIRECTIONS["axis"], _window(imaging, target)
        with threadpool_limits(1, "blas"):
            windows = window.over_band(tangent, numerics.filter_fwhm_nm)[1:]
            pyramid = _blocks(source, windows, np.array([depth_m]), tangent, numerics.block_error)
            light = partial(_with_empty_cache, window.light, pyramid, 0, tangent, [depth_m], numerics)
            cost, (_, error) = _timed(light)
        name = f"one window over 10 nm from blocks, target {target:g}"
        table.append(
            {**cost, "name": name, "series": "metafab, filter of 10 nm", "error": float(error.max()), "goal_s": goal_s}
        )
    return table


def _library(source: WrittenField, imaging: Imaging, stack_m: FloatArray, points: int) -> list[dict[str, Any]]:
    """Cost of PSFs over field and depth with their basis; wall-clock seconds on all cores."""
    grid = (np.linspace(-EDGE, EDGE, points),) * 2
    begun, start = time.process_time(), time.perf_counter()
    cost, result = _timed(lambda: psf(source, imaging, stack_m, field_tangents=grid), 1)
    basis = PsfBasis.of(result, 1e-2)
    wall_s = time.perf_counter() - start
    name = f"library of {points} x {points} directions, {len(stack_m)} depths, pair, and its basis at 1e-2"
    return [
        {
            **cost,
            "name": name,
            "series": "metafab, library",
            "error": basis.error,
            "cpu_seconds": time.process_time() - begun,
            "seconds": wall_s,
            "goal_s": LIBRARY_GOAL_S,
            "rank": basis.rank,
            "goal_rank": LIBRARY_GOAL_RANK,
        }
    ]


def _own_results(table: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of the whole stack on the axis with their true errors, for comparison with the peers."""
    errors = {row["target"]: row["error"] for row in table if row.get("direction") == "axis" and "error_x" in row}
    return [
        {**row, "error": errors[row["target"]]}
        for row in table
        if row.get("direction") == "axis" and "seconds_stack" in row
    ]


def _timed(run: Callable[[], Result], repeats: int = REPEATS) -> tuple[dict[str, Any], Result]:
    """Time and peak memory of the fastest of several runs, and the result."""
    seconds = []
    for _ in range(repeats):
        begun = time.process_time()
        result = run()
        seconds.append(time.process_time() - begun)
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
    return {"seconds": min(seconds), "peak_rss_mb": peak_mb}, result
