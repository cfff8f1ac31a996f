"""Block sums behind another ray than the one that they were summed for: other depths, field points, wavelengths."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from metafab.core.numeric.compiled import HAS_NUMBA, compiled
from metafab.optics.geometry.path import Ray, incident_amplitude, path_and_slopes
from metafab.optics.propagation.kernel import SingleComplexArray
from metafab.optics.propagation.pupil import Pupil


def refocus(pupil: Pupil, ray: Ray, wavenumber: float) -> SingleComplexArray:
    """Sums and moments behind another ray than the carrier: its path instead, and its incident amplitude.

    The change of phase is followed to second order in the block's size. ``wavenumber`` is the ray's, rad/um.

    Returns:
        Shape (3, n_y, n_x), or (1, n_y, n_x) for blocks of one site. The carrier's own path is always that in air.
    """
    block = pupil.carrier.block_sites
    orders = 1 if block == 1 else 3
    # The mean of x^2 over a full block.
    spread_x, spread_y = (pitch * pitch * (block * block - 1) / 12.0 for pitch in pupil.pitch_um)
    kernel = _refocus_compiled if HAS_NUMBA else _refocus_plain
    old, blocks = pupil.carrier.ray, np.empty((orders, *pupil.power.shape), dtype=np.complex64)
    kernel(
        blocks, pupil.sums, pupil.x_um, pupil.y_um, wavenumber, pupil.wavenumber, spread_x, spread_y,
        ray.vergence_per_um, *ray.tangent, *ray.target_um, old.vergence_per_um, *old.tangent, *old.target_um,
    )  # fmt: skip
    if ray.plate is not None:
        _through_plate(blocks, pupil, ray, wavenumber, (spread_x, spread_y))
    return blocks


def _through_plate(
    blocks: SingleComplexArray, pupil: Pupil, ray: Ray, k: float, spread_um2: tuple[float, float]
) -> None:
    """What the plate does to the blocks: phase and slopes (to first order of the block's size) and amplitude."""
    assert ray.plate is not None
    x, y, w = pupil.x_um[None, :], pupil.y_um[:, None], ray.vergence_per_um
    slopes = [k * along for along in ray.plate.slope_change(x, y, w, ray.tangent)]
    wave = np.exp(1j * k * ray.plate.path_change_um(x, y, w, ray.tangent))
    wave *= ray.plate.amplitude_ratio(x, y, w, ray.tangent)
    total = blocks[0].copy()
    if blocks.shape[0] == 3:
        second = 1.0 - 0.5 * sum(slope**2 * spread for slope, spread in zip(slopes, spread_um2, strict=True))
        blocks[0] = second * total + 1j * (slopes[0] * blocks[1] + slopes[1] * blocks[2])
        for order, (slope, spread) in enumerate(zip(slopes, spread_um2, strict=True), start=1):
            blocks[order] += 1j * slope * spread * total
    blocks *= wave


def _refocus_plain(
    blocks: Any, sums: Any, x: Any, y: Any, k: float, old_k: float, spread_x: float, spread_y: float,
    w: float, t_x: float, t_y: float, c_x: float, c_y: float, c_z: float,
    old_w: float, old_t_x: float, old_t_y: float, old_x: float, old_y: float, old_z: float,
) -> None:  # fmt: skip
    x, y = x[None, :], y[:, None]
    path, along_x, along_y = path_and_slopes(x, y, w, t_x, t_y, c_x, c_y, c_z)
    old_path, old_along_x, old_along_y = path_and_slopes(x, y, old_w, old_t_x, old_t_y, old_x, old_y, old_z)
    slope_x, slope_y = k * along_x - old_k * old_along_x, k * along_y - old_k * old_along_y
    wave = np.exp(1j * (k * path - old_k * old_path)) * incident_amplitude(x, y, w, t_x, t_y)
    second = 1.0 - 0.5 * (slope_x**2 * spread_x + slope_y**2 * spread_y)
    blocks[0] = wave * (second * sums[0] + 1j * (slope_x * sums[1] + slope_y * sums[2]))
    if blocks.shape[0] == 3:
        blocks[1] = wave * (sums[1] + 1j * slope_x * spread_x * sums[0])
        blocks[2] = wave * (sums[2] + 1j * slope_y * spread_y * sums[0])


@compiled
def _refocus_compiled(
    blocks: Any, sums: Any, x: Any, y: Any, k: float, old_k: float, spread_x: float, spread_y: float,
    w: float, t_x: float, t_y: float, c_x: float, c_y: float, c_z: float,
    old_w: float, old_t_x: float, old_t_y: float, old_x: float, old_y: float, old_z: float,
) -> None:  # fmt: skip
    blocks[:] = 0.0
    for i in range(y.size):
        for j in range(x.size):
            if sums[0, i, j] == 0.0:
                continue
            path, along_x, along_y = path_and_slopes(x[j], y[i], w, t_x, t_y, c_x, c_y, c_z)
            old = path_and_slopes(x[j], y[i], old_w, old_t_x, old_t_y, old_x, old_y, old_z)
            phase = k * path - old_k * old[0]
            slope_x, slope_y = k * along_x - old_k * old[1], k * along_y - old_k * old[2]
            amplitude = incident_amplitude(x[j], y[i], w, t_x, t_y)
            wave = amplitude * math.cos(phase) + 1j * (amplitude * math.sin(phase))
            s, s_x, s_y = sums[0, i, j], sums[1, i, j], sums[2, i, j]
            second = 1.0 - 0.5 * (slope_x * slope_x * spread_x + slope_y * slope_y * spread_y)
            blocks[0, i, j] = wave * (second * s + 1j * (slope_x * s_x + slope_y * s_y))
            if blocks.shape[0] == 3:
                blocks[1, i, j] = wave * (s_x + 1j * slope_x * spread_x * s)
                blocks[2, i, j] = wave * (s_y + 1j * slope_y * spread_y * s)
