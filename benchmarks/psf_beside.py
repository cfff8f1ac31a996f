"""PSFs beside other propagation libraries: what ``psf_peers.py`` answers, judged by the direct sum.

Each way of a peer gets lenses of the paper's steepness and pitch, from 0.1 mm up to 2 mm, as far as its time and
memory reach; its errors are measured against the direct sum at 121 points, the best common factor granted (their
normalisations are their own). Its row for 2 mm is measured, or scaled by N log N from the largest that was: the row's
name says which.

Times are over those of our fastest answer that errs no more, for one polarisation. Where a peer is exact, which sums
of blocks are not, it is our most exact answer; ``ours_error`` says how exact:

- ``ours_faster_window``: one window from what can be prepared: the field behind the lens (with the path removed), or
  our block sums.
- ``ours_faster``: the same from the pillars: what it takes to make the field in plain NumPy is added to the peer's
  time, our pass over the pillars to ours.
- ``ours_faster_stack``: 21 depths from the pillars; each depth is another field.
"""

from __future__ import annotations

import json
import os
import runpy
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.optics import Imaging, WrittenField, direct_irradiance, relative_l2
from metafab.optics.reference.direct_sum import incident_wave

PEERS_FILE = Path(__file__).with_name("psf_peers.py")
APERTURES_UM = (100.0, 200.0, 400.0, 800.0, 2000.0)
STRIDE, WINDOW_PX, JUDGED_STEP = 10, 64, 6
STACK_DEPTHS = 21

_lens = runpy.run_path(str(Path(__file__).with_name("psf_lens.py")))


def peer_rows(quick: bool, ours: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of all ways of all peers; of one that is missing, a row that says so.

    Args:
        quick: only the smallest lens.
        ours: our answers for 2 mm, one polarisation: ``error``, ``seconds_window``, ``seconds_pass``,
            ``seconds_stack`` (21 windows).
    """
    apertures_um = APERTURES_UM[:1] if quick else APERTURES_UM
    table: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        lenses = [_Given(aperture_um, Path(folder)) for aperture_um in apertures_um]
        for name in runpy.run_path(str(PEERS_FILE))["WAYS"]:
            answers, complaint = ask_peer(name, [lens.job for lens in lenses], 0.0 if quick else longest_s())
            own = [_row(name, answer, lenses) for answer in answers if "irradiance" in answer]
            if not own:
                table.append({"name": name, "error": None, "seconds": None, "peak_rss_mb": None, "skipped": complaint})
                continue
            own += [{**own[-1], **_scaled(own[-1], answer, lenses)} for answer in answers if "expected_um" in answer]
            own[-1] |= _ratios(own[-1], ours)
            # A plot of error against time shows the largest lens alone, as its other rows do.
            for row in own[:-1]:
                row |= {"seconds_of_this_lens": row["seconds"], "seconds": None}
            table += own
    return table


def longest_s() -> float:
    """METAFAB_PEERS_SECONDS: processor time up to which a peer's window is waited for."""
    return float(os.environ.get("METAFAB_PEERS_SECONDS", "20"))


def ask_peer(way: str, lenses: Sequence[dict[str, Any]], limit_s: float) -> tuple[list[dict[str, Any]], str]:
    """What a peer answered in the first of METAFAB_PEERS_PYTHON that has it, and its complaint if it ended early.

    Several interpreters are separated as in a search path; without any it is this one.
    """
    one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    job = json.dumps({"way": way, "lenses": list(lenses), "longest_s": limit_s, "most_mb": 0.3 * _free_mb()})
    complaint = "no interpreter"
    for python in os.environ.get("METAFAB_PEERS_PYTHON", sys.executable).split(os.pathsep):
        done = subprocess.run(
            [python, str(PEERS_FILE)], input=job, env=os.environ | one_thread, capture_output=True, text=True,
            check=False,
        )  # fmt: skip
        answers = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
        complaint = "" if done.returncode == 0 else (done.stderr.strip().splitlines() or ["no reason given"])[-1]
        if answers:
            return answers, complaint
    return [], complaint


class _Given:
    """A lens as the peers get it, and what is true of its window."""

    def __init__(self, aperture_um: float, folder: Path) -> None:
        design = _lens["lens_design"](aperture_um)
        self.imaging = Imaging.of(design)
        self.source: WrittenField = _lens["lens_field"](design, self.imaging)
        self.depth_m = design.sensor.focus_depth_m
        self.aperture_um = aperture_um
        self._truth: dict[float, FloatArray] = {}
        lattice = self.source.lattice
        self.pitch_um = lattice.period_dbu[0] * lattice.database_unit_nm * 1e-3
        middle = self.imaging.image_point_um(0, (0.0, 0.0))
        # The window's middle is the site next to the image point.
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
        """The direct sum at the judged points; a carrier's window is stretched along x by the grating law."""
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
    """Light polarised along x, of an object on the axis behind the lens, single precision (1e-7)."""
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


def _row(name: str, answer: dict[str, Any], lenses: Sequence[_Given]) -> dict[str, Any]:
    lens = next(lens for lens in lenses if lens.aperture_um == answer["aperture_um"])
    truth = lens.truth("carrier" in name)
    found = np.array(answer["irradiance"])[::JUDGED_STEP, ::JUDGED_STEP]
    scale = float(np.vdot(found, truth) / np.vdot(found, found))
    return {
        "name": f"{name}, {_millimetres(lens.aperture_um)}",
        "series": name,
        "aperture_um": lens.aperture_um,
        "error": relative_l2(scale * found, truth),
        "seconds": answer["seconds"],
        "field_seconds": lens.field_s + (answer["carrier_s"] if "carrier" in name else 0.0),
        "peak_rss_mb": answer["peak_rss_mb"],
    }


def _scaled(largest: dict[str, Any], answer: dict[str, Any], lenses: Sequence[_Given]) -> dict[str, Any]:
    """The peer's answer for a lens that it did not reach; its error is that of the largest one."""
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


def _ratios(peer: dict[str, Any], ours: Sequence[dict[str, Any]]) -> dict[str, float]:
    """The peer's seconds over those of our fastest answer that errs no more, or of our most exact one."""
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
    return {"ours_error": max(row["error"] for row in good)} | {
        name: theirs / min(own) for name, (theirs, own) in pairs.items()
    }


def _free_mb() -> float:
    """Memory that is free for a peer (Linux; elsewhere 4 GB are taken to be)."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    except OSError:
        return 4096.0
    return next(float(line.split()[1]) / 1024.0 for line in lines if line.startswith("MemAvailable"))
