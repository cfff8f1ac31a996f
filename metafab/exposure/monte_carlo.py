"""Monte Carlo simulation of electrons in a stack of layers: energy deposited in the resist against radius.

Elastic scattering by the screened Rutherford cross-section with its relativistic correction, energy loss continuously
along the path: by the relativistic Bethe formula, and below 10 keV by Joy and Luo's modification (Scanning 11, 176,
1989). Cross-section and angle as in D. C. Joy, Monte Carlo Modeling for Electron Microscopy and Microanalysis, 1995:

    alpha = 3.4e-3 Z^0.67 / E,
    sigma = 5.21e-21 Z^2 / E^2  4 pi / (alpha (1 + alpha))  ((E + 511) / (E + 1022))^2 cm^2,
    cos(theta) = 1 - 2 alpha R / (1 + alpha - R),   E in keV, R uniform in [0, 1].

Secondary electrons are not followed. They widen the innermost 10 nm; the blur of the beam includes them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.numeric.compiled import compiled, compiled_parallel, prange

#: Electrons are followed down to this energy (keV); their range is then below 10 nm.
_STOP_KEV = 0.5
#: Histories of one random sequence; sequences do not depend on the number of threads.
_BATCH = 500
#: Radii of the table: bins per decade, from 1 nm to 1 mm.
_BINS_PER_DECADE, _DECADES = 8, 6

#: Atomic number: atomic weight (g/mol) and mean excitation energy (keV; ICRU report 37, 1984).
ELEMENTS = {
    1: (1.008, 0.0192),
    6: (12.011, 0.0780),
    8: (15.999, 0.0950),
    13: (26.982, 0.1660),
    14: (28.086, 0.1730),
    15: (30.974, 0.1730),
    31: (69.723, 0.3340),
    33: (74.922, 0.3470),
    49: (114.818, 0.4880),
    79: (196.967, 0.7900),
}


@dataclass(frozen=True)
class Layer:
    """A homogeneous layer.

    Attributes:
        formula: atoms per formula unit, by atomic number.
        density_g_per_cm3: mass density.
        thickness_nm: ``math.inf`` for the substrate.
    """

    formula: tuple[tuple[int, float], ...]
    density_g_per_cm3: float
    thickness_nm: float


@dataclass(frozen=True)
class ElectronHistogram:
    """Result of a simulation.

    Attributes:
        radius_nm: shape (n,), geometric centres of the rings.
        density: shape (n,), energy deposited in the resist per area and electron, keV / nm^2.
        statistical_error: shape (n,), relative standard error of ``density``.
        backscattered: share of electrons that leave through the surface with more than 0.5 keV.
        deposited_kev: mean energy deposited in the resist per electron.
        electrons: number of histories.
    """

    radius_nm: FloatArray
    density: FloatArray
    statistical_error: FloatArray
    backscattered: float
    deposited_kev: float
    electrons: int


SILICON = ((14, 1.0),)
SILICA = ((14, 1.0), (8, 2.0))
SAPPHIRE = ((13, 2.0), (8, 3.0))
HSQ = ((1, 1.0), (14, 1.0), (8, 1.5))
PMMA = ((6, 5.0), (8, 2.0), (1, 8.0))
GALLIUM_ARSENIDE = ((31, 1.0), (33, 1.0))


def simulate(stack: Sequence[Layer], beam_kev: float, electrons: int = 40_000, seed: int = 1) -> ElectronHistogram:
    """Simulate a point beam at normal incidence.

    Args:
        stack: layers from the surface down, the resist first; the last one is infinitely thick.
        beam_kev: energy of the electrons, 2 to 300 keV.
        electrons: number of histories.
        seed: of the random numbers.

    Raises:
        InputError: an energy out of range, an unknown element, or a stack without substrate.
    """
    if not 2.0 <= beam_kev <= 300.0:
        raise InputError.single("monte_carlo", "beam_kev", "2 to 300 keV", f"{beam_kev:g}")
    if len(stack) < 1 or not math.isinf(stack[-1].thickness_nm):
        raise InputError.single("monte_carlo", "stack", "a last layer of infinite thickness", f"{len(stack)} layers")
    unknown = {z for layer in stack for z, _ in layer.formula} - set(ELEMENTS)
    if unknown:
        raise InputError.single("monte_carlo", "formula", f"elements {sorted(ELEMENTS)}", f"{sorted(unknown)}")
    most = max(len(layer.formula) for layer in stack)
    number = np.zeros((len(stack), most))
    per_nm3, stopping = np.zeros_like(number), np.zeros_like(number)
    for i, layer in enumerate(stack):
        weight = sum(count * ELEMENTS[z][0] for z, count in layer.formula)
        for j, (z, count) in enumerate(layer.formula):
            number[i, j] = z
            per_nm3[i, j] = layer.density_g_per_cm3 * 6.02214e23 / weight * count * 1e-21
            stopping[i, j] = ELEMENTS[z][1]
    bottom = np.cumsum([layer.thickness_nm for layer in stack])
    batches = -(-electrons // _BATCH)
    bins = _BINS_PER_DECADE * _DECADES
    deposited = np.zeros((batches, bins))
    left = np.zeros(batches)
    _run(number, per_nm3, stopping, bottom, beam_kev, seed, deposited, left)
    edges = 10.0 ** (np.arange(bins + 1) / _BINS_PER_DECADE)
    edges[0] = 0.0
    area = math.pi * np.diff(edges**2)
    mean = deposited.mean(axis=0)
    spread = deposited.std(axis=0, ddof=1) / math.sqrt(batches) if batches > 1 else mean
    return ElectronHistogram(
        radius_nm=10.0 ** ((np.arange(bins) + 0.5) / _BINS_PER_DECADE),
        density=mean / (_BATCH * area),
        statistical_error=np.divide(spread, mean, out=np.ones(bins), where=mean > 0.0),
        backscattered=float(left.sum() / (batches * _BATCH)),
        deposited_kev=float(mean.sum() / _BATCH),
        electrons=batches * _BATCH,
    )


@compiled
def _cross_section_nm2(z: float, energy_kev: float) -> float:
    """Screened Rutherford cross-section of an atom."""
    alpha = 3.4e-3 * z**0.67 / energy_kev
    relativistic = ((energy_kev + 511.0) / (energy_kev + 1022.0)) ** 2
    # 5.21e-21 cm^2 = 5.21e-7 nm^2
    cross_section: float = 5.21e-7 * z * z / energy_kev**2 * 4.0 * math.pi * relativistic / (alpha * (1.0 + alpha))
    return cross_section


@compiled
def _stopping_kev_nm2(excitation_kev: float, energy_kev: float) -> float:
    """Energy loss per path and electron density: relativistic Bethe, below 10 keV Joy and Luo."""
    if energy_kev > 10.0:
        tau = energy_kev / 511.0
        beta2 = tau * (tau + 2.0) / (tau + 1.0) ** 2
        ratio = excitation_kev / 511.0
        tail = 1.0 - beta2 + (tau * tau / 8.0 - (2.0 * tau + 1.0) * math.log(2.0)) / (tau + 1.0) ** 2
        logarithm = math.log(tau * tau * (tau + 2.0) / (2.0 * ratio * ratio)) + tail
        # 2 pi r_e^2 m c^2 = 2 pi (2.8179e-6 nm)^2 511 keV
        loss: float = 2.5496e-8 / beta2 * logarithm
        return loss
    bent = excitation_kev / (1.0 + 0.85 * excitation_kev / energy_kev)
    # 2 pi e^4 / (4 pi eps0)^2 / E: 2 pi (1.44e-3 keV nm)^2
    return 1.3029e-5 / energy_kev * math.log(1.166 * energy_kev / bent)


@compiled
def _turned(
    cx: float, cy: float, cz: float, cos_theta: float, sin_theta: float, phi: float
) -> tuple[float, float, float]:
    """Direction (cx, cy, cz) turned by a polar angle theta and an azimuth phi about itself."""
    across = math.sqrt(cx * cx + cy * cy)
    if across < 1e-9:
        sign = 1.0 if cz > 0.0 else -1.0
        return sin_theta * math.cos(phi), sin_theta * math.sin(phi), sign * cos_theta
    u, v = sin_theta * math.cos(phi), sin_theta * math.sin(phi)
    x = cx * cos_theta + (cx * cz * u - cy * v) / across
    y = cy * cos_theta + (cy * cz * u + cx * v) / across
    z = cz * cos_theta - across * u
    norm = math.sqrt(x * x + y * y + z * z)
    return x / norm, y / norm, z / norm


@compiled
def _sums_per_nm(
    number: FloatArray, per_nm3: FloatArray, stopping: FloatArray, layer: int, energy_kev: float
) -> tuple[float, float]:
    """Macroscopic elastic cross-section (1/nm) and energy loss (keV/nm) of a layer, both summed over its elements."""
    elastic, loss = 0.0, 0.0
    for j in range(number.shape[1]):
        z = number[layer, j]
        if z > 0.0:
            elastic += per_nm3[layer, j] * _cross_section_nm2(z, energy_kev)
            loss += per_nm3[layer, j] * z * _stopping_kev_nm2(stopping[layer, j], energy_kev)
    return elastic, loss


@compiled
def _struck_atom(number: FloatArray, per_nm3: FloatArray, layer: int, energy_kev: float, chosen: float) -> float:
    """Atomic number at ``chosen`` (1/nm) of the cumulative macroscopic cross-sections of a layer."""
    z_atom = number[layer, 0]
    for j in range(number.shape[1]):
        if number[layer, j] > 0.0:
            z_atom = number[layer, j]
            chosen -= per_nm3[layer, j] * _cross_section_nm2(z_atom, energy_kev)
            if chosen <= 0.0:
                break
    return float(z_atom)


@compiled
def _free_path(z: float, cz: float, step: float, top: float, bottom: float) -> tuple[float, int]:
    """Shorten a step to the layer's face if it crosses it; -1, 0, 1: up, not at all, down.

    The exponential law has no memory, so the path starts afresh behind the face.
    """
    if cz > 0.0 and z + step * cz > bottom:
        return (bottom - z) / cz, 1
    if cz < 0.0 and z + step * cz < top:
        return (top - z) / cz, -1
    return step, 0


@compiled_parallel
def _run(
    number: FloatArray,
    per_nm3: FloatArray,
    stopping: FloatArray,
    bottom: FloatArray,
    beam_kev: float,
    seed: int,
    deposited: FloatArray,
    left: FloatArray,
) -> None:
    for batch in prange(deposited.shape[0]):
        np.random.seed(seed * 1_000_003 + batch)
        for _ in range(_BATCH):
            energy, x, y, z = beam_kev, 0.0, 0.0, 0.0
            cx, cy, cz = 0.0, 0.0, 1.0
            layer = 0
            while energy > _STOP_KEV:
                elastic, loss = _sums_per_nm(number, per_nm3, stopping, layer, energy)
                top = 0.0 if layer == 0 else bottom[layer - 1]
                free = -math.log(1.0 - np.random.random()) / elastic
                step, crossed = _free_path(z, cz, free, top, bottom[layer])
                lost = min(energy, loss * step)
                if layer == 0:
                    # Deposited at a random place of the step.
                    share = np.random.random() * step
                    radius = math.hypot(x + share * cx, y + share * cy)
                    place = 0 if radius < 1.0 else int(math.log10(radius) * _BINS_PER_DECADE)
                    if place < deposited.shape[1]:
                        deposited[batch, place] += lost
                energy -= lost
                x, y, z = x + step * cx, y + step * cy, z + step * cz
                if crossed != 0:
                    layer += crossed
                    if layer < 0:
                        left[batch] += 1.0
                        break
                    continue
                z_atom = _struck_atom(number, per_nm3, layer, energy, np.random.random() * elastic)
                alpha = 3.4e-3 * z_atom**0.67 / max(energy, 0.01)
                r = np.random.random()
                cos_theta = 1.0 - 2.0 * alpha * r / (1.0 + alpha - r)
                sin_theta = math.sqrt(max(0.0, 1.0 - cos_theta * cos_theta))
                cx, cy, cz = _turned(cx, cy, cz, cos_theta, sin_theta, 2.0 * math.pi * np.random.random())
