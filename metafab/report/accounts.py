"""What the accounts of a run consist of, read from its summary and its PSFs."""

from __future__ import annotations

import numpy as np

from metafab.camera.frames.frame import RawFrame
from metafab.core.conventions import POLARISATIONS, FloatArray
from metafab.decode.image import Image4D
from metafab.optics.point_spread import Psf
from metafab.report.figures.psf import depth_text
from metafab.report.run_folder import RunFolder

Stage = tuple[str, float]
BudgetLine = tuple[str, float, str]


def chain_of(run: RunFolder) -> list[Stage]:
    """Share of the light at the aperture after each stage, mean over polarisations and depths.

    By the figures of merit, where the run has them, each stage takes its factor down to the light through the
    pinhole. Without them, the last stage is for comparison: the target phases alone, without a mask.
    """
    losses = (run.part("merit").get("loss_chain") or {}).get("losses") or []
    if losses:
        shares = np.cumprod([1.0, *(float(np.mean(loss["factor"])) for loss in losses if loss["factor"])])
        names = ["at the aperture", *(str(loss["stage"]) for loss in losses if loss["factor"])]
        return list(zip(names, shares.tolist(), strict=True))
    if run.psf is None:
        return []
    stages = [("at the aperture", 1.0)]
    figures = run.part("psf")
    transmitted = [float(figures[key]) for p in POLARISATIONS if (key := f"transmitted_{p}") in figures]
    if transmitted and run.has_mask:
        stages.append(("through the pillars", float(np.mean(transmitted))))
    stages.append(("in the window of its PSF", float(np.mean(run.psf.efficiency))))
    if run.ideal_psf is not None:
        stages.append(("for comparison: target phases, in the window", float(np.mean(run.ideal_psf.efficiency))))
    return stages


def budget_of(run: RunFolder) -> list[BudgetLine]:
    """The measured lines of the error budget: source, value, unit."""
    lines = run.summary.get("error_budget") or []
    return [
        (str(line.get("source", "")), float(line["value"]), str(line.get("unit", "")))
        for line in lines
        if isinstance(line, dict) and isinstance(line.get("value"), int | float)
    ]


def seconds_of(run: RunFolder) -> dict[str, float]:
    """Time of each step."""
    return {step: float(value) for step, value in run.part("seconds").items() if isinstance(value, int | float)}


def modulation_of(psf: Psf) -> tuple[FloatArray, list[tuple[str, FloatArray]]]:
    """Modulation transfer of PSF_x at the nearest, middle and farthest depth: |Fourier transform|, 1 at zero.

    Returns:
        Spatial frequencies on the sensor, shape (n,), per mm, the mean of each ring of directions; and the name and
        transfer, shape (n,), of each depth. Light outside the PSF's window is not in it.
    """
    _, n_depth, n_y, n_x = psf.psf.shape
    step_per_mm = 1e3 / (min(n_y, n_x) * psf.pixel_um)
    f_y, f_x = (np.fft.fftfreq(n, 1e-3 * psf.pixel_um) for n in (n_y, n_x))
    radius = np.hypot(f_y[:, None], f_x[None, :])
    ring = np.rint(radius / step_per_mm).astype(np.int64)
    count = (min(n_y, n_x) + 1) // 2
    inside = ring < count
    pixels = np.bincount(ring[inside], minlength=count)
    curves = []
    for depth in dict.fromkeys((0, n_depth // 2, n_depth - 1)):
        transfer = np.abs(np.fft.fft2(psf.psf[0, depth]))
        mean = np.bincount(ring[inside], transfer[inside], count) / pixels
        curves.append((depth_text(float(psf.depth_m[depth])), mean / mean[0]))
    return np.bincount(ring[inside], radius[inside], count) / pixels, curves


def depths_against_truth(run: RunFolder) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """True depth, decoded depth and standard error of every segment whose truth the raw frame carries."""
    decoded = run.decoded
    true_m = None if decoded is None or run.raw is None else _truth_on(decoded, run.raw)
    if decoded is None or true_m is None:
        return None
    errors = {figures.number: figures.error_m for figures in decoded.segments}
    rows = []
    for number in np.unique(decoded.segment[decoded.segment > 0]):
        inside = (decoded.segment == number) & np.isfinite(decoded.depth_m) & np.isfinite(true_m)
        if inside.any():
            rows.append((np.median(true_m[inside]), np.median(decoded.depth_m[inside]), errors.get(int(number), 0.0)))
    if not rows:
        return None
    true, found, error = np.array(rows, dtype=np.float64).T
    return true, found, error


def _truth_on(decoded: Image4D, raw: RawFrame) -> FloatArray | None:
    """True depth at the decoded pixels, NaN beyond the truth's grid; both grids share the pixel pitch."""
    if raw.truth is None or raw.truth_origin_um is None:
        return None
    true_m = np.full(decoded.depth_m.shape, np.nan)
    indices = []
    for axis in (1, 0):
        offset = (decoded.origin_um[axis] - raw.truth_origin_um[axis]) / raw.pixel_um
        indices.append(np.arange(decoded.depth_m.shape[1 - axis]) + round(offset))
    row, column = np.meshgrid(*indices, indexing="ij")
    n_y, n_x = raw.truth.depth_m.shape
    known = (row >= 0) & (row < n_y) & (column >= 0) & (column < n_x)
    true_m[known] = raw.truth.depth_m[row[known], column[known]]
    return true_m
