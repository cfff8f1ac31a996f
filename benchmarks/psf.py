"""PSF benchmarks: error against the direct sum over every pillar, seconds and memory."""

from __future__ import annotations

import math
import resource
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.layout.geometry import lattice_of
from metafab.layout.pillars import PillarMap
from metafab.optics import Imaging, Psf, WrittenField, depth_nodes, direct_irradiance, psf, relative_l2
from metafab.phase import SpiralZonesPhase, SplitLensPhase
from metafab.spec import Design, load_design

LAYOUTS = Path(__file__).parent.parent / "layouts"
LEVELS = 30
REFERENCE_POINTS = 12


def rows(quick: bool) -> list[dict[str, Any]]:
    """Error, seconds and peak memory of PSF stacks; the 2 mm lens unless ``quick``.

    The mask holds 30 x 30 phase levels at 90 % amplitude of Eqs. 2 to 4, so that nothing but the optics room
    counts. ``error`` is the true one, on 12 x 12 points spread over the window, the worst of objects at 25, 30 and
    60 cm; ``stated`` the largest of the result.
    """
    design = load_design(LAYOUTS / ("helix_small.toml" if quick else "helix_2mm.toml"))
    imaging = Imaging.of(design)
    source = _mask(design, imaging)
    near, far = design.verify.depths_m[0], design.verify.depths_m[-1]
    judged = [near, (near + far) / 2.0, 2.0 * far] if quick else [0.25, 0.30, 0.60]
    # Field of +-3.6 degrees, the paper's aperture stop.
    edge = math.tan(math.radians(3.6))
    nodes = depth_nodes(imaging, near, far, 1e-3)
    psf(source, imaging, [near], window_px=16)  # compiles
    found = []
    for name, tangent in (
        ("axis", (0.0, 0.0)),
        ("3.6 degrees", (edge, 0.5 * edge)),
        ("-3.6 degrees", (-edge, 0.5 * edge)),
    ):
        truth = _truth(source, imaging, judged, tangent)
        for target in (1e-2, 1e-3, 1e-4):
            row, result = _timed(
                f"{design.name}, {name}, {len(judged)} depths, target {target:g}",
                lambda target=target, tangent=tangent: psf(
                    source, imaging, judged, tangent=tangent, target_error=target
                ),
            )
            step = result.psf.shape[-1] // REFERENCE_POINTS
            sampled = result.psf[0, :, ::step, ::step][:, :REFERENCE_POINTS, :REFERENCE_POINTS]
            error = max(relative_l2(*pair) for pair in zip(sampled, truth, strict=True))
            found.append({**row, "error": error, "stated": float(result.error.max())})
    for target in (1e-2, 1e-3):
        row, result = _timed(
            f"{design.name}, axis, {nodes.size} depths, filter of 10 nm, target {target:g}",
            lambda target=target: psf(source, imaging, nodes, target_error=target, filter_fwhm_nm=10.0),
        )
        found.append({**row, "error": float(result.error.max()), "stated": float(result.error.max())})
    for points in (5,) if quick else (5, 9):
        grid = (np.linspace(-edge, edge, points),) * 2
        row, result = _timed(
            f"{design.name}, field {points} x {points}, {nodes.size} depths",
            lambda grid=grid: psf(source, imaging, nodes, field_tangents=grid),
        )
        found.append({**row, "error": float(result.details["field_error"]), "stated": float(result.error.max())})
    return found


def _timed(name: str, run: Callable[[], Psf]) -> tuple[dict[str, Any], Psf]:
    wall, cpu = time.perf_counter(), time.process_time()
    result = run()
    row = {
        "name": name,
        "seconds": time.perf_counter() - wall,
        "cpu_seconds": time.process_time() - cpu,
        "blocks": result.details["blocks"],
        "peak_rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }
    return row, result


def _truth(
    source: WrittenField, imaging: Imaging, depths_m: Sequence[float], tangent: tuple[float, float]
) -> FloatArray:
    """The direct sum on every fifth point of a 64 px window along either side, shape (n_depth, 12, 12)."""
    step = 64 // REFERENCE_POINTS
    axis = (np.arange(REFERENCE_POINTS) * step - 32) * imaging.pixel_um
    centre = imaging.image_point_um(0, tangent)
    x, y = np.meshgrid(centre[0] + axis, centre[1] + axis)
    truth = direct_irradiance(source, imaging, depths_m, tangent, x.ravel(), y.ravel(), 0)
    return truth.reshape(len(depths_m), REFERENCE_POINTS, REFERENCE_POINTS)


def _mask(design: Design, imaging: Imaging) -> WrittenField:
    lattice = lattice_of(design)
    x, y = lattice.x_um(), lattice.y_um()
    radius = 0.5 * design.device.aperture_um
    terms = (
        SpiralZonesPhase(4, 0.5, radius),
        SplitLensPhase(imaging.wavelength_um, 1e3 * imaging.focal_length_mm, imaging.split_angle_deg),
    )
    index = np.zeros(lattice.shape, dtype=np.uint16)
    for row in range(0, y.size, 256):
        part = slice(row, row + 256)
        levels = [
            np.rint(sum(t(x, y[part], p) for t in terms) / (2.0 * np.pi) * LEVELS).astype(np.int64) % LEVELS
            for p in ("x", "y")
        ]
        inside = np.hypot(x[None, :], y[part, None]) <= radius
        index[part] = np.where(inside, 1 + levels[0] + LEVELS * levels[1], 0)
    phasor = np.exp(2j * np.pi * np.arange(LEVELS) / LEVELS)
    table = np.zeros((LEVELS * LEVELS + 1, 2), dtype=np.complex128)
    table[1:, 0], table[1:, 1] = 0.9 * np.tile(phasor, LEVELS), 0.9 * np.repeat(phasor, LEVELS)
    pillars = PillarMap.from_array(replace(lattice), np.zeros((table.shape[0], 2), np.int32), index, 286)
    return WrittenField(pillars, table)


if __name__ == "__main__":
    import sys

    for row in rows("--full" not in sys.argv):
        print({key: (f"{value:.3g}" if isinstance(value, float) else value) for key, value in row.items()})
