"""Transfer block sums from the carrier ray to another ray: another depth, field point or wavelength."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from metafab.core.numeric.compiled import compiled
from metafab.optics.geometry.path import Ray, RayNumbers, incident_amplitude, path_and_slopes
from metafab.optics.geometry.polarisation import Weight
from metafab.optics.propagation.kernel import SingleComplexArray
from metafab.optics.propagation.pupil import Pupil


def refocus(pupil: Pupil, ray: Ray, wavenumber: float) -> SingleComplexArray:
    """Return sums and moments with the path and incident amplitude of ``ray`` in place of the carrier's.

    The change of phase is followed to second order in the block size. The carrier's path is always that in air; the new
    ray has a wave number of its own, with or without a plate. Their shape is (3, n_y, n_x), or (1, n_y, n_x) for blocks
    of one site.
    """
    orders = 1 if pupil.carrier.block_sites == 1 else 3
    blocks = np.empty((orders, *pupil.power.shape), dtype=np.complex64)
    _refocus(
        blocks,
        pupil.sums,
        pupil.x_um,
        pupil.y_um,
        pupil.spread_um2,
        wavenumber,
        ray.numbers,
        pupil.wavenumber,
        pupil.carrier.ray.numbers,
    )
    if ray.plate is not None:
        blocks = _behind_plate(blocks, pupil, ray, wavenumber)
    return blocks if ray.crystal is None else _behind_crystal(blocks, pupil, ray)


def _behind_crystal(blocks: SingleComplexArray, pupil: Pupil, ray: Ray) -> SingleComplexArray:
    """Multiply blocks by an entry of the crystal's Jones matrix, to first order of the block size."""
    factor = ray.jones_factor(pupil.x_um, pupil.y_um)
    behind = (factor * blocks).astype(np.complex64)
    if blocks.shape[0] == 3:
        for axis, order in ((1, 1), (0, 2)):
            if factor.shape[axis] < 2:
                continue
            slope = np.gradient(factor, pupil.block_um[order - 1], axis=axis)
            behind[0] += slope * blocks[order]
            behind[order] += slope * pupil.spread_um2[order - 1] * blocks[0]
    return behind


def weighted(blocks: SingleComplexArray, pupil: Pupil, weight: Weight) -> SingleComplexArray:
    """Return refocused blocks times a factor that is smooth over a block; its slope follows to first order.

    The blocks are those of :func:`refocus`, shape (3, n_y, n_x) or (1, n_y, n_x), at the places of ``pupil``.
    """
    x, y = pupil.x_um[None, :], pupil.y_um[:, None]
    here = weight(x, y)
    product = (blocks * here).astype(np.complex64)
    if blocks.shape[0] == 3:
        half_x, half_y = (0.5 * side for side in pupil.block_um)
        slopes = (
            (weight(x + half_x, y) - weight(x - half_x, y)) / (2.0 * half_x),
            (weight(x, y + half_y) - weight(x, y - half_y)) / (2.0 * half_y),
        )
        product[0] += slopes[0] * blocks[1] + slopes[1] * blocks[2]
        for order, (slope, spread) in enumerate(zip(slopes, pupil.spread_um2, strict=True), start=1):
            product[order] += slope * spread * blocks[0]
    return product


def _behind_plate(blocks: SingleComplexArray, pupil: Pupil, ray: Ray, wavenumber: float) -> SingleComplexArray:
    """Multiply blocks by the phase, phase slopes (to first order of the block size) and amplitude of the plate."""
    assert ray.plate is not None
    x, y, vergence = pupil.x_um[None, :], pupil.y_um[:, None], ray.vergence_per_um
    slopes = [wavenumber * slope for slope in ray.plate.slope_change(x, y, vergence, ray.tangent)]
    wave = np.exp(1j * wavenumber * ray.plate.path_change_um(x, y, vergence, ray.tangent))
    wave *= ray.plate.amplitude_ratio(x, y, vergence, ray.tangent)
    behind = blocks.copy()
    if blocks.shape[0] == 3:
        second = 1.0 - 0.5 * sum(slope**2 * spread for slope, spread in zip(slopes, pupil.spread_um2, strict=True))
        behind[0] = second * blocks[0] + 1j * (slopes[0] * blocks[1] + slopes[1] * blocks[2])
        for order, (slope, spread) in enumerate(zip(slopes, pupil.spread_um2, strict=True), start=1):
            behind[order] += 1j * slope * spread * blocks[0]
    behind *= wave
    return behind


@compiled
def _refocus(
    blocks: Any,
    sums: Any,
    x: Any,
    y: Any,
    spread_um2: tuple[float, float],
    wavenumber: float,
    ray: RayNumbers,
    carrier_wavenumber: float,
    carrier: RayNumbers,
) -> None:
    spread_x, spread_y = spread_um2
    blocks[:] = 0.0
    for i in range(y.size):
        for j in range(x.size):
            if sums[0, i, j] == 0.0:
                continue
            path, along_x, along_y = path_and_slopes(x[j], y[i], ray)
            old_path, old_along_x, old_along_y = path_and_slopes(x[j], y[i], carrier)
            phase = wavenumber * path - carrier_wavenumber * old_path
            slope_x = wavenumber * along_x - carrier_wavenumber * old_along_x
            slope_y = wavenumber * along_y - carrier_wavenumber * old_along_y
            amplitude = incident_amplitude(x[j], y[i], ray)
            wave = amplitude * math.cos(phase) + 1j * (amplitude * math.sin(phase))
            s, s_x, s_y = sums[0, i, j], sums[1, i, j], sums[2, i, j]
            second = 1.0 - 0.5 * (slope_x * slope_x * spread_x + slope_y * slope_y * spread_y)
            blocks[0, i, j] = wave * (second * s + 1j * (slope_x * s_x + slope_y * s_y))
            if blocks.shape[0] == 3:
                blocks[1, i, j] = wave * (s_x + 1j * slope_x * spread_x * s)
                blocks[2, i, j] = wave * (s_y + 1j * slope_y * spread_y * s)
