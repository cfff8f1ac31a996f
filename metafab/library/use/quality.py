"""Figures of merit of a library: coverage of the phase pairs, transmittance, and sensitivity to a bias of sizes."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree

from metafab.core.conventions import ComplexArray, FloatArray, covered_rad, wrap_phase
from metafab.core.figures import Quality
from metafab.library.library import Library
from metafab.library.use.amplitudes import power_transmittance
from metafab.library.use.lookup import best_overlap, phase_slope_per_nm

#: Cells of the (phi_x, phi_y) torus along each phase: steps of 0.049 rad.
CELLS = 128
#: Distance (rad) within which a size covers a phase; one size covers a pair if it covers both phases.
REACH_RAD = 0.1
#: Least power transmittance, in both polarisations, of a size that covers phases.
LEAST_TRANSMITTANCE = 0.5
#: Bias (nm) of width and length together for which the sensitivity is given.
CD_BIAS_NM = 5.0


def coverage_rad(library: Library) -> float:
    """Return the covered part of the phase circle, at most 2 pi, of the polarisation with less coverage."""
    t = _transparent(library)
    return min(covered_rad(np.angle(t[:, axis]), REACH_RAD) for axis in (0, 1))


def quality(library: Library) -> Quality:
    """Return the figures of merit of a library."""
    t = library.t[library.known]
    index, overlap = best_overlap(t, CELLS)
    chosen = index.astype(np.intp) - 1
    phase = 2.0 * math.pi * np.arange(CELLS) / CELLS
    targets = np.stack(np.broadcast_arrays(phase[None, :], phase[:, None]), axis=-1)
    error_rad = wrap_phase(np.angle(t[chosen]) - targets)
    slope = phase_slope_per_nm(library)[library.known][chosen]
    passed = power_transmittance(library)[library.known]
    hole_rad, hole = _worst_hole(_transparent(library), targets)
    # The root of the power over |t| is not 1: the half spaces have different impedances.
    root_power_per_t = float(np.sqrt(passed / np.maximum(np.abs(t) ** 2, 1e-300)).mean())
    return Quality(
        coverage_rad=coverage_rad(library),
        torus_coverage=float(np.mean(hole_rad <= REACH_RAD)),
        worst_hole_rad=float(hole_rad.max()),
        worst_hole_phase_x_rad=float(wrap_phase(hole[0])),
        worst_hole_phase_y_rad=float(wrap_phase(hole[1])),
        phase_rms_error_rad=float(np.sqrt(np.mean(error_rad**2))),
        phase_max_error_rad=float(np.abs(error_rad).max()),
        mean_transmittance=float(passed[chosen].mean()),
        mean_overlap=float(overlap.mean() * root_power_per_t / 2.0),
        cd_phase_rms_rad=float(CD_BIAS_NM * np.sqrt(np.mean(slope**2))),
    )


def _transparent(library: Library) -> ComplexArray:
    """Transmission of the sizes with high transmittance in both polarisations: shape (n, 2)."""
    transparent = np.all(power_transmittance(library) >= LEAST_TRANSMITTANCE, axis=-1)
    return np.asarray(library.t[library.known & transparent])


def _worst_hole(t: ComplexArray, targets: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distance of every target to the nearest size, in the worse of both phases; and the farthest target."""
    if t.size == 0:
        return np.full(targets.shape[:-1], math.pi), np.zeros(2)
    turn = 2.0 * math.pi
    # Twice: a tiny negative phase becomes a whole turn first, which the tree refuses.
    phase = np.asarray(np.mod(np.mod(np.angle(t), turn), turn), dtype=np.float64)
    tree = cKDTree(phase, boxsize=np.array([turn, turn]))
    distance = np.asarray(tree.query(targets, p=np.inf)[0], dtype=np.float64)
    return distance, targets[np.unravel_index(int(np.argmax(distance)), distance.shape)]
