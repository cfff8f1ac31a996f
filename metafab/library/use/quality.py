"""How good a library is: which pairs of phases it reaches, what it loses there, and what a CD bias does to it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from metafab.core.conventions import ComplexArray, FloatArray, power_transmittance, wrap_phase
from metafab.library.library import Library
from metafab.library.use.lookup import best_overlap, phase_slope_per_nm
from metafab.materials import refractive_index

#: Cells of the (phi_x, phi_y) torus along each phase at which figures are taken: steps of 0.049 rad.
CELLS = 128
#: A phase is covered if a size has it to within this; so is a pair of phases if one size has both.
REACH_RAD = 0.1
#: Sizes that transmit less power than this, in either polarisation, do not count as covering anything.
LEAST_TRANSMITTANCE = 0.5
#: The bias of width and length together for which the sensitivity is given.
CD_BIAS_NM = 5.0


def coverage_rad(library: Library) -> float:
    """How much of the phase circle is covered, for the polarisation that is worse off: 2 pi at best."""
    t = _calm(library)
    return min(_covered_rad(np.angle(t[:, axis])) for axis in (0, 1))


def quality(library: Library) -> dict[str, float]:
    """Figures of merit of a library, for targets that are spread evenly over the (phi_x, phi_y) torus.

    Returns:
        ``coverage_rad``: see :func:`coverage_rad`; ``torus_coverage``: share of all pairs of phases that a well
        transmitting size reaches to within 0.1 rad in both; ``worst_hole_rad`` at ``worst_hole_phase_x_rad``,
        ``worst_hole_phase_y_rad``: the pair that is farthest from any such size, and how far in its worse phase;
        ``phase_rms_error_rad``, ``phase_max_error_rad``: of the sizes with the best overlap, both polarisations;
        ``mean_transmittance``, ``mean_overlap``: of these sizes (overlap 1 for |t|^2 n_out/n_in = 1 without phase
        error); ``cd_phase_rms_rad``: rms phase change of these sizes when both sides grow by 5 nm (for -5 nm it is
        the same with the other sign, to first order).
    """
    t_all = _flat(library)
    index, overlap = best_overlap(t_all, CELLS)
    chosen = index.astype(np.intp) - 1
    phase = 2.0 * math.pi * np.arange(CELLS) / CELLS
    targets = np.stack(np.broadcast_arrays(phase[None, :], phase[:, None]), axis=-1)
    error_rad = wrap_phase(np.angle(t_all[chosen]) - targets)
    slope = phase_slope_per_nm(library)[library.known][chosen]
    transmittance = _transmittance(library, t_all)
    hole_rad, hole = _worst_hole(_calm(library), targets)
    # |t| of a perfect pillar differs from 1 by the impedances of the half spaces.
    perfect = float(np.sqrt(transmittance / np.maximum(np.abs(t_all) ** 2, 1e-300)).mean())
    return {
        "coverage_rad": coverage_rad(library),
        "torus_coverage": float(np.mean(hole_rad <= REACH_RAD)),
        "worst_hole_rad": float(hole_rad.max()),
        "worst_hole_phase_x_rad": float(wrap_phase(hole[0])),
        "worst_hole_phase_y_rad": float(wrap_phase(hole[1])),
        "phase_rms_error_rad": float(np.sqrt(np.mean(error_rad**2))),
        "phase_max_error_rad": float(np.abs(error_rad).max()),
        "mean_transmittance": float(transmittance[chosen].mean()),
        "mean_overlap": float(overlap.mean() * perfect / 2.0),
        "cd_phase_rms_rad": float(CD_BIAS_NM * np.sqrt(np.mean(slope**2))),
    }


def _flat(library: Library) -> ComplexArray:
    """Both polarisations of every size that is made: shape (n_sizes, 2)."""
    return np.stack([library.t_xx[0][library.known], library.t_yy[0][library.known]], axis=-1)


def _transmittance(library: Library, t: ComplexArray) -> FloatArray:
    """Zero-order power transmittance, shape of ``t``; last axis x and y polarisation."""
    materials, light = library.unit_cell.materials, library.unit_cell.illumination
    n_substrate, n_ambient = (
        refractive_index(m, light.wavelength_nm) for m in (materials.substrate, materials.ambient)
    )
    n_in, n_out = (n_substrate, n_ambient) if light.side == "substrate" else (n_ambient, n_substrate)
    return np.stack([power_transmittance(t[..., axis], n_in[axis], n_out[axis]) for axis in (0, 1)], axis=-1)


def _calm(library: Library) -> ComplexArray:
    """The sizes that transmit well in both polarisations: shape (n, 2)."""
    t = _flat(library)
    return t[np.all(_transmittance(library, t) >= LEAST_TRANSMITTANCE, axis=-1)]


def _covered_rad(phase_rad: FloatArray) -> float:
    """The circle without the parts of its gaps that lie farther than the reach from both ends."""
    if phase_rad.size == 0:
        return 0.0
    ordered = np.sort(phase_rad)
    gaps = np.diff(ordered, append=ordered[:1] + 2.0 * math.pi)
    return 2.0 * math.pi - float(np.sum(np.maximum(gaps - 2.0 * REACH_RAD, 0.0)))


def _worst_hole(t: ComplexArray, targets: FloatArray) -> tuple[FloatArray, NDArray[np.float64]]:
    """Distance of every target to the nearest size, in the worse of both phases; and the farthest target."""
    if t.size == 0:
        return np.full(targets.shape[:-1], math.pi), np.zeros(2)
    turn = 2.0 * math.pi
    phase = np.asarray(np.mod(np.mod(np.angle(t), turn), turn), dtype=np.float64)
    tree = cKDTree(phase, boxsize=np.array([turn, turn]))
    distance = np.asarray(tree.query(targets, p=np.inf)[0], dtype=np.float64)
    return distance, targets[np.unravel_index(int(np.argmax(distance)), distance.shape)]
