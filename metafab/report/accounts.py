"""What the accounts of a run consist of, read from its summary and its PSFs."""

from __future__ import annotations

from typing import Any

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.report.run_folder import RunFolder

Stage = tuple[str, float]
BudgetLine = tuple[str, float, str]


def chain_of(run: RunFolder) -> list[Stage]:
    """Share of the light at the aperture after each stage, mean over polarisations and depths.

    The target phases alone already spread some light beyond the window; what the written pillars lose on top
    (transmission, phase error, diffraction by the lattice of sizes) is the step to the file's own efficiency.
    """
    stages: list[Stage] = []
    stated = run.summary.get("loss_chain")
    if isinstance(stated, list):
        return [(str(row["stage"]), float(row["share"])) for row in stated if {"stage", "share"} <= set(row)]
    if run.psf is None:
        return stages
    stages.append(("at the aperture", 1.0))
    if run.ideal_psf is not None:
        stages.append(("target phases: in the window", float(np.mean(run.ideal_psf.efficiency))))
    stages.append(("written file: in the window", float(np.mean(run.psf.efficiency))))
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


def depths_against_truth(run: RunFolder) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """True depth, decoded depth and standard error of every segment whose truth the raw frame carries."""
    raw, decoded = run.raw, run.decoded
    if raw is None or decoded is None or raw.truth is None or raw.truth.depth_m.shape != decoded.depth_m.shape:
        return None
    errors = {int(row["number"]): row.get("error_m", 0.0) for row in decoded.segments if "number" in row}
    rows: list[tuple[Any, ...]] = []
    for number in np.unique(decoded.segment[decoded.segment > 0]):
        inside = (decoded.segment == number) & np.isfinite(decoded.depth_m) & np.isfinite(raw.truth.depth_m)
        if inside.any():
            true, found = np.median(raw.truth.depth_m[inside]), np.median(decoded.depth_m[inside])
            rows.append((true, found, errors.get(int(number), 0.0)))
    if not rows:
        return None
    true_m, decoded_m, error_m = np.array(rows, dtype=np.float64).T
    return true_m, decoded_m, error_m
