"""FDTD by Meep: error against RCWA, time that the driver saves, coupling of neighbours, and a whole tiny lens.

- ``cells``: ten pillars with W != L (one square), resonant ones included; by the exact exchange of x and y they stand
  for nineteen. ``error`` is the largest |t - t_ref| against RCWA at 1e-4 in adapted coordinates, ``difference_fourier``
  that against the limit of plain harmonics.
- ``savings``: processor time of one polarisation of one cell at 100 px/um, by the driver and by a plain script
  (``meep_plain.py``).
- ``supercell``: a row of unlike pillars, extrapolated from two grids with all walls on nodes, against RCWA of the row.
- ``lens``: a lens of 9.8 um and its focal spot by Meep's field against the library's; ``error`` is the relative L2 of
  the irradiance. About ten minutes.

``peak_rss_mb`` is that of the largest worker so far.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cell.fourier_limit import fourier_limit
from benchmarks.optics.direct_sum import Sites, direct_irradiance
from metafab.cell import CellNumerics, PillarCell, elements, rcwa
from metafab.cell.elements import ElementNumerics
from metafab.cell.meep import MeepSettings, Pool, SupercellSettings, finding, solve, solve_supercell
from metafab.cell.meep.grid import family, plan
from metafab.cell.supercell import Supercell
from metafab.fullwave.patch import field_difference
from metafab.layout import Lattice
from metafab.optics import Imaging

PLAIN_SCRIPT = Path(__file__).with_name("meep_plain.py")
CELL = PillarCell(
    period_nm=(350.0, 350.0),
    width_nm=120.0,
    length_nm=180.0,
    height_nm=600.0,
    n_pillar=3.6941 + 0.0065j,
    n_substrate=(1.7601 + 0j, 1.7601 + 0j),
    n_ambient=1.0 + 0j,
    wavelength_nm=800.0,
)
#: (width, length) in nm on or near guided-mode resonances.
RESONANT = ((150.0, 210.0), (145.0, 245.0), (155.0, 185.0), (220.0, 195.0), (250.0, 250.0))
#: Target error of Meep; finer grids are added until its stated error is below, or there are none.
TARGET = 1e-2


def drawn(count: int = 5) -> tuple[tuple[float, float], ...]:
    """Sizes between 100 and 250 nm, W != L, whose grids have the fewest pixels: a minute or two each."""
    sizes: list[tuple[float, float]] = []
    for width, length in np.random.default_rng(20261121).integers(100, 251, (400, 2)):
        cell = replace(CELL, width_nm=float(width), length_nm=float(length))
        if width != length and family(cell).period == (5, 5) and len(sizes) < count:
            sizes.append((float(width), float(length)))
    return tuple(sizes)


def rows(quick: bool) -> list[dict[str, Any]]:
    """Rows of name, error, seconds and peak memory.

    Args:
        quick: one pillar on coarse grids, the savings, and no lens.
    """
    with Pool(1) as pool:
        table = list(_cells(pool, RESONANT[:1] if quick else (*RESONANT, *drawn()), (1, 2) if quick else (1, 2, 3, 4)))
        if not quick:
            table += list(_supercell(pool))
            table += list(_lens(pool))
    table += list(_savings())
    # The peak memory of the largest worker is known once all have ended.
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024.0
    return [row | {"peak_rss_mb": peak} for row in table]


def _cells(pool: Pool, sizes: tuple[tuple[float, float], ...], members: tuple[int, ...]) -> Iterator[dict[str, Any]]:
    for width, length in sizes:
        cell = replace(CELL, width_nm=width, length_nm=length)
        reference, plain = rcwa.solve(cell, CellNumerics(target_error=1e-4)), fourier_limit(cell)
        response = solve(cell, CellNumerics(target_error=TARGET, solver="meep"), MeepSettings(members), pool)
        difference = float(np.max(np.abs(response.t - reference.t)))
        yield _row(f"{width:g} x {length:g} nm", difference, response.seconds) | {
            "stated_error": response.error,
            "within_stated": difference <= response.error + reference.error,
            "difference_fourier": float(np.max(np.abs(response.t - plain.t))),
            "stated_error_fourier": plain.error,
            "pixels_per_um": response.resolution,
        }


def _savings() -> Iterator[dict[str, Any]]:
    """Processor time at 100 px/um: a quarter cell with its tail extrapolated, and a whole cell until it dies."""
    reference = complex(rcwa.solve(CELL, CellNumerics(target_error=1e-4)).t[0, 0])
    grids = family(CELL)
    member = next(m for m in range(1, 9) if 2 * m * grids.period[0] >= 0.1 * CELL.period_nm[0])
    run = plan(CELL, grids, "x", member, decay=1e-3, longest_time=800.0)
    before = _children_s()
    with Pool(1) as pool:
        reply = pool.run(run.job)
    ours = _children_s() - before
    t = run.amplitudes(reply["limit"][:, 0, 0], reply["incident"])[0]
    yield _row(f"driver, {run.job.n_x} px a period", abs(t - reference), ours)
    index = complex(CELL.n_pillar)
    script = {
        "wavelength_um": CELL.wavelength_nm * 1e-3,
        "period_um": CELL.period_nm[0] * 1e-3,
        "width_um": CELL.width_nm * 1e-3,
        "length_um": CELL.length_nm * 1e-3,
        "height_um": CELL.height_nm * 1e-3,
        "n_in": CELL.n_in[0].real,
        "n_out": CELL.n_out[0].real,
        "n_pillar": [index.real, index.imag],
        "pixels_per_um": 100,
    }
    before = _children_s()
    done = subprocess.run(
        [str(finding.best().interpreter), "-I", str(PLAIN_SCRIPT)],
        input=json.dumps(script),
        text=True,
        capture_output=True,
        env=finding.clean_environment(),
        check=True,
    )
    plain = _children_s() - before
    # Meep itself prints on stdout, too.
    answer = next(json.loads(line) for line in done.stdout.splitlines() if line.startswith("{"))
    yield _row("plain script, 35 px a period", abs(complex(*answer["t"]) - reference), plain) | {
        "times_slower": plain / ours
    }


def _children_s() -> float:
    """Processor seconds of all workers that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _supercell(pool: Pool) -> Iterator[dict[str, Any]]:
    """Three unlike pillars whose walls lie on the nodes of both grids; the plain h^2 limit of the two."""
    row = Supercell(CELL, np.array([[(100.0, 150.0), (150.0, 100.0), (200.0, 200.0)]]))
    for light in ("x", "y"):
        reference = elements.solve_supercell(row, light, ElementNumerics(1e-3))
        coarse, fine = (solve_supercell(row, light, SupercellSettings(px), pool) for px in (14, 28))
        limit = fine.co_polarised + (fine.co_polarised - coarse.co_polarised) / 3.0
        difference = float(np.max(np.abs(limit - reference.co_polarised)))
        yield _row(f"row of 3, {light}, against RCWA", difference, coarse.seconds + fine.seconds) | {
            "stated_error": reference.error,
            "coupling_meep": fine.coupling_error,
            "coupling_rcwa": reference.coupling_error,
            "rcwa_seconds": reference.seconds,
        }


def _lens(pool: Pool, count: int = 28, focus_um: float = 10.0, padding: int = 2) -> Iterator[dict[str, Any]]:
    """A lens of square pillars: focal spots of Meep's field and of the library's, by one propagator."""
    place = (np.arange(count) - (count - 1) / 2.0) * 0.35
    radius = np.hypot(place[:, None], place)
    inside = radius <= 0.5 * count * 0.35
    sides = np.arange(100.0, 251.0, 2.0)
    own = np.array(
        [rcwa.solve(replace(CELL, width_nm=s, length_nm=s), CellNumerics(target_error=1e-3)).t[0, 0] for s in sides]
    )
    wanted = np.exp(-2j * np.pi / 0.8 * (np.hypot(radius, focus_um) - focus_um))
    chosen = np.argmax((own * wanted[..., None].conj()).real, axis=-1)
    side = np.where(inside, sides[chosen], 0.0)
    sizes = np.pad(np.stack([side, side], axis=-1), ((padding, padding), (padding, padding), (0, 0)))
    supercell = Supercell(CELL, sizes)
    start = time.perf_counter()
    answer = solve_supercell(supercell, "x", SupercellSettings(12, 1e-2), pool)
    seconds = time.perf_counter() - start
    whole = supercell.at_sites(answer.order, answer.co_polarised)
    full_wave = np.where(inside, whole[padding:-padding, padding:-padding], 0.0)
    alone = np.where(inside, answer.responses[padding:-padding, padding:-padding], 0.0)
    library = np.where(inside, own[chosen], 0.0)
    lattice = Lattice(period_dbu=(700, 700), shape=(count, count), database_unit_nm=0.5)
    imaging = Imaging(
        wavelength_um=0.8,
        focal_length_mm=focus_um * 1e-3,
        split_angle_deg=0.0,
        sensor_distance_um=focus_um,
        pixel_um=0.1,
        aperture_um=count * 0.35,
        aperture_shape="circle",
    )
    axis = np.linspace(-3.0, 3.0, 61)
    x, y = (grid.ravel() for grid in np.meshgrid(axis, axis))
    by_meep, by_library, by_grid = (
        direct_irradiance(Sites(lattice, field), imaging, 1e3, (0.0, 0.0), x, y, 0).reshape(61, 61)
        for field in (full_wave, library, alone)
    )
    for name, theirs, field in (("the library", by_library, library), ("lone pillars on the grid", by_grid, alone)):
        phase_rms = field_difference(full_wave[inside], field[inside]).phase_rms_rad
        yield _row(f"lens of 9.8 um, focus by Meep against {name}", _l2(by_meep, theirs), seconds) | {
            "peak_ratio": float(by_meep.max() / theirs.max()),
            "fwhm_um": [_fwhm_um(by_meep[30], axis), _fwhm_um(theirs[30], axis)],
            "phase_rms_rad": phase_rms,
        }


def _l2(ours: np.ndarray, theirs: np.ndarray) -> float:
    return float(np.linalg.norm(ours - theirs) / np.linalg.norm(theirs))


def _fwhm_um(line: np.ndarray, axis: np.ndarray) -> float:
    """Full width at half maximum of the main peak, linear between samples."""
    half, peak = 0.5 * line.max(), int(np.argmax(line))
    left = peak - int(np.argmax(line[peak::-1] < half))
    right = peak + int(np.argmax(line[peak:] < half))
    low = np.interp(half, [line[left], line[left + 1]], [axis[left], axis[left + 1]])
    high = np.interp(half, [line[right], line[right - 1]], [axis[right], axis[right - 1]])
    return float(high - low)


def _row(name: str, error: float, seconds: float) -> dict[str, Any]:
    return {"name": name, "error": error, "seconds": seconds}


if __name__ == "__main__":
    print(json.dumps(rows("--quick" in sys.argv), indent=2))
