"""Comparison of PSFs with other propagation libraries (``psf_peers.py``), judged by the direct sum.

Each method of a peer gets lenses of the paper's numerical aperture and pitch, from 0.1 mm up to 2 mm, as far as its
time and memory allow. Its error is measured against the direct sum at 121 points, up to a common factor, as
normalisations differ. Its row for 2 mm is measured, or scaled by N log N from the largest measured lens and named so.

Ratios of times are those of the peer over our fastest result of no larger error, for one polarisation. If the peer is
exact, our most exact result is taken; ``ours_error`` is its error.

- ``ours_faster_window``: one window from prepared data: the field behind the lens (with the path removed), or our
  block sums.
- ``ours_faster``: one window from the pillars, with the time to make the field in NumPy, or our pass over the pillars.
- ``ours_faster_stack``: 21 depths from the pillars; each depth is another field.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.optics.direct_sum import direct_irradiance, incident_wave
from benchmarks.optics.psf_lens import lens_design, lens_field
from benchmarks.optics.psf_peers import METHODS
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.optics import Imaging, WrittenField, relative_l2

PEERS_FILE = Path(__file__).with_name("psf_peers.py")
APERTURES_UM = (100.0, 200.0, 400.0, 800.0, 2000.0)
STRIDE, WINDOW_PX, JUDGED_STEP = 10, 64, 6
STACK_DEPTHS = 21


def peer_rows(
    ours: Sequence[dict[str, Any]], apertures_um: Sequence[float] = APERTURES_UM, limit_s: float | None = None
) -> list[dict[str, Any]]:
    """Return the rows of all methods of all peers; a missing peer gives a row with the reason.

    Args:
        ours: our results for 2 mm, one polarisation: ``error``, ``seconds_window``, ``seconds_pass``,
            ``seconds_stack`` (21 windows).
        apertures_um: diameters of the lenses, ascending.
        limit_s: longest processor time of a peer's window; METAFAB_PEERS_SECONDS, or 20 s, if None.
    """
    limit_s = float(os.environ.get("METAFAB_PEERS_SECONDS", "20")) if limit_s is None else limit_s
    table: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        lenses = [PeerLens(aperture_um, Path(folder)) for aperture_um in apertures_um]
        for name in METHODS:
            answers, complaint = ask_peer(name, [lens.job for lens in lenses], limit_s)
            rows = [peer_row(name, answer, lenses) for answer in answers if "irradiance" in answer]
            if not rows:
                table.append({"name": name, "error": None, "seconds": None, "peak_rss_mb": None, "skipped": complaint})
                continue
            rows += [{**rows[-1], **_scaled(rows[-1], answer, lenses)} for answer in answers if "expected_um" in answer]
            rows[-1] |= time_ratios(rows[-1], ours)
            # The plot of error against time shows the largest lens only.
            for row in rows[:-1]:
                row |= {"seconds_of_this_lens": row["seconds"], "seconds": None}
            table += rows
    return table


def ask_peer(method: str, lenses: Sequence[dict[str, Any]], limit_s: float) -> tuple[list[dict[str, Any]], str]:
    """Run a peer in the first interpreter of METAFAB_PEERS_PYTHON that has it.

    The variable is a search path; without it, this interpreter is taken.

    Returns:
        The answers, and the last line of stderr if the program failed.
    """
    one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    job = json.dumps({"method": method, "lenses": list(lenses), "longest_s": limit_s, "most_mb": 0.3 * _free_mb()})
    complaint = "no interpreter"
    for python in os.environ.get("METAFAB_PEERS_PYTHON", sys.executable).split(os.pathsep):
        done = subprocess.run(
            [python, str(PEERS_FILE)],
            input=job,
            env=os.environ | one_thread,
            capture_output=True,
            text=True,
            check=False,
        )
        answers = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
        complaint = "" if done.returncode == 0 else (done.stderr.strip().splitlines() or ["no reason given"])[-1]
        if answers:
            return answers, complaint
    return [], complaint


class PeerLens:
    """A lens as the peers get it, with the true irradiance of its window."""

    def __init__(self, aperture_um: float, folder: Path) -> None:
        design = lens_design(aperture_um)
        self.imaging = Imaging.of(design)
        self.source = lens_field(design, self.imaging)
        self.depth_m = design.sensor.focus_depth_m
        self.aperture_um = aperture_um
        self._truth: dict[float, FloatArray] = {}
        lattice = self.source.lattice
        self.pitch_um = lattice.period_dbu[0] * lattice.database_unit_nm * 1e-3
        middle = self.imaging.image_point_um(0, (0.0, 0.0))
        # The middle of the window is the site next to the image point.
        self.first = [
            round((at - axis[0]) / self.pitch_um) - STRIDE * (WINDOW_PX // 2)
            for at, axis in ((middle[1], lattice.y_um()), (middle[0], lattice.x_um()))
        ]
        path = folder / f"{aperture_um:g}.npy"
        start = time.process_time()
        field = _behind(self.source, self.imaging, self.depth_m)
        self.field_s = time.process_time() - start
        np.save(path, field)
        self.job = {
            "aperture_um": aperture_um,
            "field": str(path),
            "pitch_um": self.pitch_um,
            "wavelength_um": self.imaging.wavelength_um,
            "distance_um": self.imaging.sensor_distance_um,
            "first": self.first,
            "window_px": WINDOW_PX,
            "stride": STRIDE,
        }

    def truth(self, carrier: bool) -> FloatArray:
        """Return the direct sum at the judged points, with ``carrier`` stretched along x by the grating law."""
        axes = self.source.lattice.x_um(), self.source.lattice.y_um()
        x, y = (
            axis[0] + self.pitch_um * (first + STRIDE * np.arange(WINDOW_PX))
            for axis, first in zip(axes, self.first[::-1], strict=True)
        )
        middle_x, middle_y = x[WINDOW_PX // 2], y[WINDOW_PX // 2]
        square = middle_x**2 + middle_y**2 + self.imaging.sensor_distance_um**2
        stretch = 1.0 / (1.0 - middle_x**2 / square) if carrier else 1.0
        if stretch not in self._truth:
            points = np.meshgrid(middle_x + stretch * (x[::JUDGED_STEP] - middle_x), y[::JUDGED_STEP])
            shape = points[0].shape
            self._truth[stretch] = direct_irradiance(
                self.source, self.imaging, self.depth_m, (0.0, 0.0), points[0].ravel(), points[1].ravel(), 0
            ).reshape(shape)
        return self._truth[stretch]


def _behind(source: WrittenField, imaging: Imaging, depth_m: float) -> ComplexArray:
    """Field of x polarised light of an object on the axis behind the lens, in single precision (1e-7)."""
    field = np.zeros(source.lattice.shape, dtype=np.complex64)
    x, y = source.lattice.x_um(), source.lattice.y_um()
    for tile in source.tiles():
        light = tile.amplitude(0)
        rows, columns = (
            slice(start, start + count) for start, count in zip((tile.row, tile.column), light.shape, strict=True)
        )
        wave = incident_wave(0.0, 0.0, 1e6 * depth_m, x[columns], y[rows], imaging.wavenumber)
        field[rows, columns] = 1e6 * depth_m * light * wave
    return field


def peer_row(name: str, answer: dict[str, Any], lenses: Sequence[PeerLens]) -> dict[str, Any]:
    """Return the row of one answer, with its error up to a common factor."""
    lens = next(lens for lens in lenses if lens.aperture_um == answer["aperture_um"])
    truth = lens.truth("carrier" in name)
    image = np.array(answer["irradiance"])[::JUDGED_STEP, ::JUDGED_STEP]
    scale = float(np.vdot(image, truth) / np.vdot(image, image))
    return {
        "name": f"{name}, {_millimetres(lens.aperture_um)}",
        "series": name,
        "aperture_um": lens.aperture_um,
        "error": relative_l2(scale * image, truth),
        "seconds": answer["seconds"],
        "field_seconds": lens.field_s + (answer["carrier_s"] if "carrier" in name else 0.0),
        "peak_rss_mb": answer["peak_rss_mb"],
    }


def _scaled(largest: dict[str, Any], answer: dict[str, Any], lenses: Sequence[PeerLens]) -> dict[str, Any]:
    """The extrapolated cost of a lens beyond the limits; its error is that of the largest measured lens."""
    lens, reached = (
        next(lens for lens in lenses if lens.aperture_um == aperture_um)
        for aperture_um in (answer["expected_um"], largest["aperture_um"])
    )
    carrier_s = (largest["field_seconds"] - reached.field_s) * (lens.aperture_um / reached.aperture_um) ** 2
    return {
        "name": f"{largest['name']}, scaled on to {_millimetres(lens.aperture_um)}",
        "seconds": answer["seconds"],
        "field_seconds": lens.field_s + carrier_s,
        "peak_rss_mb": answer["peak_rss_mb"],
    }


def _millimetres(length_um: float) -> str:
    return f"{1e-3 * length_um:g} mm"


def time_ratios(peer: dict[str, Any], ours: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Return the peer's times over those of our fastest result of no larger error, or of our most exact result."""
    if not ours:
        return {}
    least = min(row["error"] for row in ours)
    good = [row for row in ours if row["error"] <= max(peer["error"], least)]
    window, whole = peer["seconds"], peer["seconds"] + peer["field_seconds"]
    pairs = {
        "ours_faster_window": (window, [row["seconds_window"] for row in good]),
        "ours_faster": (whole, [row["seconds_pass"] + row["seconds_window"] for row in good]),
        "ours_faster_stack": (STACK_DEPTHS * whole, [row["seconds_pass"] + row["seconds_stack"] for row in good]),
    }
    ratios = {name: theirs / min(times) for name, (theirs, times) in pairs.items()}
    return {"ours_error": max(row["error"] for row in good), **ratios}


def _free_mb() -> float:
    """Free memory, MB; 4 GB are assumed on other systems than Linux."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    except OSError:
        return 4096.0
    return next(float(line.split()[1]) / 1024.0 for line in lines if line.startswith("MemAvailable"))
