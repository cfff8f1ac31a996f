"""Monte Carlo simulation of electrons in a stack of layers: energy deposited in the resist against radius.

Elastic scattering by single collisions with the Wentzel cross-section of an atom, screened after Moliere and multiplied
by the Mott ratio in McKinley and Feshbach's approximation (Phys. Rev. 74, 1759, 1948):

    chi = hbar / (p a) sqrt(1.13 + 3.76 (Z / 137 beta)^2),   a = 0.885 a_0 Z^(-1/3),   alpha = chi^2 / 4,
    sigma = pi (Z e^2 / (4 pi eps0 p v))^2 / (alpha (1 + alpha)),
    cos(theta) = 1 - 2 alpha R / (1 + alpha - R),   R uniform in [0, 1],
    ratio = 1 - beta^2 s^2 + pi Z beta s (1 - s) / 137,   s = sin(theta / 2).

Close to the nucleus the electron is slower than outside by the potential of the atom's electrons, V = 48.73 eV
Z^(4/3), which turns it further: the ratio of Andersen et al. (Phys. Rev. A 21, 1891, 1980) for ions, with the sign of
the charge reversed, where it is above 1,

    ((1 - v / 2) / (1 - v + v^2 / (4 s^2)))^2,   v = V / E.

At small angles the screening alpha holds in its place. Collisions with the electrons of the atom deflect as well: they
count as one more unit of charge (Z^2 + Z), up to a loss of 0.4 % of the energy. Harder ones are left out:
the electron that is turned has lost the energy to come back, but the continuous loss takes it from all alike.

Energy is lost continuously along the path: by the relativistic Bethe formula, and below 10 keV by Joy and Luo's
modification (Scanning 11, 176, 1989), with the mean excitation energies and the rule for compounds of ICRU report 37
(1984).

The approximation of the Mott ratio holds for light atoms: gold is beyond it.

Secondary electrons are not followed. They widen the innermost 10 nm; the blur of the beam includes them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.numeric.compiled import compiled
from metafab.core.parallel.executor import kept_threads, spread

#: Electrons are followed down to this energy (keV); their range is then below 10 nm.
_STOP_KEV = 0.5
#: sin^2(theta / 2) of the largest deflection by an electron, a quarter of the share of energy that it costs. With
#: 0.02, backscatter at 100 keV is 4 to 9 % higher.
_ELECTRON_SINE2 = 1e-3
#: Potential of an atom's electrons at the nucleus over Z^(4/3), keV, and its largest share of the energy.
_CLOUD_KEV, _CLOUD_SHARE = 0.04873, 0.5
#: Fine-structure constant.
_FINE_STRUCTURE = 1.0 / 137.036
#: Avogadro constant (1/mol).
_AVOGADRO = 6.02214e23
#: Histories of one random sequence; sequences do not depend on the number of threads.
_BATCH = 500
#: Radii of the table: bins per decade, from 1 nm to 1 mm.
_BINS_PER_DECADE, _DECADES = 8, 6

#: Atomic number: atomic weight (g/mol), mean excitation energy of the element and in a compound (keV; ICRU report 37,
#: 1984: in condensed compounds 1.13 times that of the element, with values of their own for H, C, O and Cl).
ELEMENTS = {
    1: (1.008, 0.0192, 0.0192),
    6: (12.011, 0.0780, 0.0810),
    8: (15.999, 0.0950, 0.1060),
    13: (26.982, 0.1660, 0.1876),
    14: (28.086, 0.1730, 0.1955),
    15: (30.974, 0.1730, 0.1955),
    17: (35.453, 0.1740, 0.1800),
    31: (69.723, 0.3340, 0.3774),
    33: (74.922, 0.3470, 0.3921),
    49: (114.818, 0.4880, 0.5514),
}


@dataclass(frozen=True)
class Layer:
    """A homogeneous layer."""

    formula: tuple[tuple[int, float], ...]  #: Atoms per formula unit, by atomic number.
    density_g_per_cm3: float  #: Mass density.
    thickness_nm: float  #: ``math.inf`` for the substrate.


@dataclass(frozen=True)
class ElectronHistogram:
    """Result of a simulation."""

    radius_nm: FloatArray  #: Shape (n,), geometric centres of the rings.
    density: FloatArray  #: Shape (n,), energy deposited in the resist per area and electron, keV / nm^2.
    statistical_error: FloatArray  #: Shape (n,), relative standard error of ``density``.
    backscattered: float  #: Share of electrons that leave through the surface with more than 0.5 keV.
    deposited_kev: float  #: Mean energy deposited in the resist per electron.
    depth_nm: FloatArray  #: Shape (electrons,), largest depth of each electron: beyond a foil's thickness it leaves it.
    electrons: int  #: Number of histories.


ALUMINIUM = ((13, 1.0),)
SILICON = ((14, 1.0),)
SILICA = ((14, 1.0), (8, 2.0))
SAPPHIRE = ((13, 2.0), (8, 3.0))
HSQ = ((1, 1.0), (14, 1.0), (8, 1.5))
PMMA = ((6, 5.0), (8, 2.0), (1, 8.0))
#: Copolymer of alpha-methylstyrene and methyl alpha-chloroacrylate, one to one (ZEP520).
ZEP = ((6, 13.0), (1, 15.0), (17, 1.0), (8, 2.0))
GALLIUM_ARSENIDE = ((31, 1.0), (33, 1.0))


def simulate(
    stack: Sequence[Layer], beam_kev: float, electrons: int = 40_000, seed: int = 1, resist: int = 0
) -> ElectronHistogram:
    """Simulate a point beam at normal incidence.

    Args:
        stack: layers from the surface down; the last one is infinitely thick.
        beam_kev: energy of the electrons, 2 to 300 keV.
        electrons: number of histories.
        seed: of the random numbers.
        resist: layer whose deposited energy is counted, from 0.

    Raises:
        InputError: an energy out of range, an unknown element, a stack without substrate, or no such layer.
    """
    if not 2.0 <= beam_kev <= 300.0:
        raise InputError.single("monte_carlo", "beam_kev", "2 to 300 keV", f"{beam_kev:g}")
    if len(stack) < 1 or not math.isinf(stack[-1].thickness_nm):
        raise InputError.single("monte_carlo", "stack", "a last layer of infinite thickness", f"{len(stack)} layers")
    if not 0 <= resist < len(stack):
        raise InputError.single("monte_carlo", "resist", f"a layer from 0 to {len(stack) - 1}", f"{resist}")
    unknown = {z for layer in stack for z, _ in layer.formula} - set(ELEMENTS)
    if unknown:
        raise InputError.single("monte_carlo", "formula", f"elements {sorted(ELEMENTS)}", f"{sorted(unknown)}")
    most = max(len(layer.formula) for layer in stack)
    number = np.zeros((len(stack), most))
    per_nm3, excitation_kev = np.zeros_like(number), np.zeros(len(stack))
    for i, layer in enumerate(stack):
        for j, (z, count) in enumerate(layer.formula):
            number[i, j] = z
            per_nm3[i, j] = _per_nm3(layer, count)
        excitation_kev[i] = mean_excitation_kev(layer.formula)
    bottom = np.cumsum([layer.thickness_nm for layer in stack])
    batches = -(-electrons // _BATCH)
    bins = _BINS_PER_DECADE * _DECADES
    deposited = np.zeros((batches, bins))
    left, depth_nm = np.zeros(batches), np.zeros((batches, _BATCH))
    with kept_threads():
        spread(
            _run, batches, number, per_nm3, excitation_kev, bottom, beam_kev, seed, resist, deposited, left, depth_nm
        )
    edges = 10.0 ** (np.arange(bins + 1) / _BINS_PER_DECADE)
    edges[0] = 0.0
    area = math.pi * np.diff(edges**2)
    mean = deposited.mean(axis=0)
    deviation = deposited.std(axis=0, ddof=1) / math.sqrt(batches) if batches > 1 else mean
    return ElectronHistogram(
        radius_nm=10.0 ** ((np.arange(bins) + 0.5) / _BINS_PER_DECADE),
        density=mean / (_BATCH * area),
        statistical_error=np.divide(deviation, mean, out=np.ones(bins), where=mean > 0.0),
        backscattered=float(left.sum() / (batches * _BATCH)),
        deposited_kev=float(mean.sum() / _BATCH),
        depth_nm=depth_nm.ravel(),
        electrons=batches * _BATCH,
    )


def mean_excitation_kev(formula: tuple[tuple[int, float], ...]) -> float:
    """Mean excitation energy of a material (keV): weighted geometrically by electrons."""
    place = 1 if len(formula) == 1 else 2
    electrons = sum(z * count for z, count in formula)
    return math.exp(sum(z * count * math.log(ELEMENTS[z][place]) for z, count in formula) / electrons)


def _per_nm3(layer: Layer, count: float) -> float:
    """Number density (1/nm^3) of particles of which each formula unit of a layer has ``count``."""
    weight = sum(number * ELEMENTS[z][0] for z, number in layer.formula)
    return layer.density_g_per_cm3 * _AVOGADRO / weight * count * 1e-21


def energy_loss_kev_per_nm(layer: Layer, energy_kev: float) -> float:
    """Mean energy loss per path in a layer."""
    electrons = sum(z * count for z, count in layer.formula)
    return _per_nm3(layer, electrons) * float(_stopping_kev_nm2(mean_excitation_kev(layer.formula), energy_kev))


@compiled
def _elastic(z: float, energy_kev: float) -> tuple[float, float]:
    """Cross-section of an atom and its electrons (nm^2), times the bound of its ratios; screening alpha."""
    momentum2 = energy_kev * (energy_kev + 1022.0)  # (p c)^2, keV^2
    beta2 = momentum2 / (energy_kev + 511.0) ** 2
    # hbar c = 0.19733 keV nm; a_0 = 0.052918 nm
    radius = 0.885 * 0.052918 * z ** (-1.0 / 3.0)
    alpha = 0.25 * 0.19733**2 / (momentum2 * radius**2) * (1.13 + 3.76 * (z * _FINE_STRUCTURE) ** 2 / beta2)
    # e^2 / (4 pi eps0) = 1.43996e-3 keV nm
    area = math.pi * (1.43996e-3) ** 2 / (momentum2 * beta2) * z * (z + 1.0) / (alpha * (1.0 + alpha))
    return area * _ratio_bound(z, energy_kev, beta2), alpha


@compiled
def _ratio_bound(z: float, energy_kev: float, beta2: float) -> float:
    """Upper bound of the Mott ratio times that of the electrons' potential, which is largest straight backwards."""
    bound: float = (1.0 + 0.25 * math.pi * _FINE_STRUCTURE * z * math.sqrt(beta2)) * _cloud_ratio(z, energy_kev, 1.0)
    return bound


@compiled
def _cloud_ratio(z: float, energy_kev: float, sine2: float) -> float:
    """Ratio of cross-sections by the potential of the atom's electrons, at least 1."""
    v = min(_CLOUD_KEV * z ** (4.0 / 3.0) / energy_kev, _CLOUD_SHARE)
    ratio: float = ((1.0 - 0.5 * v) / (1.0 - v + 0.25 * v * v / max(sine2, 1e-9))) ** 2
    return max(1.0, ratio)


@compiled
def _accepted(z: float, energy_kev: float, sine2: float, random: float) -> bool:
    """Whether a collision with sin^2(theta / 2) = ``sine2`` takes place: both ratios, soft collisions of electrons."""
    beta2 = energy_kev * (energy_kev + 1022.0) / (energy_kev + 511.0) ** 2
    sine = math.sqrt(sine2)
    ratio = 1.0 - beta2 * sine2 + math.pi * _FINE_STRUCTURE * z * math.sqrt(beta2) * sine * (1.0 - sine)
    ratio *= _cloud_ratio(z, energy_kev, sine2)
    if sine2 > _ELECTRON_SINE2:
        ratio *= z / (z + 1.0)
    return bool(random * _ratio_bound(z, energy_kev, beta2) < ratio)


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
    number: FloatArray, per_nm3: FloatArray, excitation_kev: FloatArray, layer: int, energy_kev: float
) -> tuple[float, float]:
    """Macroscopic elastic cross-section (1/nm) and energy loss (keV/nm) of a layer, both summed over its elements."""
    elastic, electrons = 0.0, 0.0
    for j in range(number.shape[1]):
        z = number[layer, j]
        if z > 0.0:
            elastic += per_nm3[layer, j] * _elastic(z, energy_kev)[0]
            electrons += per_nm3[layer, j] * z
    return elastic, electrons * _stopping_kev_nm2(excitation_kev[layer], energy_kev)


@compiled
def _struck_atom(number: FloatArray, per_nm3: FloatArray, layer: int, energy_kev: float, chosen: float) -> float:
    """Atomic number at ``chosen`` (1/nm) of the cumulative macroscopic cross-sections of a layer."""
    z_atom = number[layer, 0]
    for j in range(number.shape[1]):
        if number[layer, j] > 0.0:
            z_atom = number[layer, j]
            chosen -= per_nm3[layer, j] * _elastic(z_atom, energy_kev)[0]
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


@compiled
def _run(
    first: int,
    stop: int,
    number: FloatArray,
    per_nm3: FloatArray,
    excitation_kev: FloatArray,
    bottom: FloatArray,
    beam_kev: float,
    seed: int,
    resist: int,
    deposited: FloatArray,
    left: FloatArray,
    depth_nm: FloatArray,
) -> None:
    for batch in range(first, stop):
        np.random.seed(seed * 1_000_003 + batch)
        for history in range(_BATCH):
            energy, x, y, z = beam_kev, 0.0, 0.0, 0.0
            cx, cy, cz = 0.0, 0.0, 1.0
            layer = 0
            while energy > _STOP_KEV:
                elastic, loss = _sums_per_nm(number, per_nm3, excitation_kev, layer, energy)
                top = 0.0 if layer == 0 else bottom[layer - 1]
                free = -math.log(1.0 - np.random.random()) / elastic
                step, crossed = _free_path(z, cz, free, top, bottom[layer])
                lost = min(energy, loss * step)
                if layer == resist:
                    # Deposited at a random place of the step.
                    share = np.random.random() * step
                    radius = math.hypot(x + share * cx, y + share * cy)
                    place = 0 if radius < 1.0 else int(math.log10(radius) * _BINS_PER_DECADE)
                    if place < deposited.shape[1]:
                        deposited[batch, place] += lost
                energy -= lost
                x, y, z = x + step * cx, y + step * cy, z + step * cz
                depth_nm[batch, history] = max(depth_nm[batch, history], z)
                if crossed != 0:
                    layer += crossed
                    if layer < 0:
                        left[batch] += 1.0
                        break
                    continue
                z_atom = _struck_atom(number, per_nm3, layer, energy, np.random.random() * elastic)
                energy = max(energy, 0.01)
                alpha = _elastic(z_atom, energy)[1]
                r = np.random.random()
                sine2 = alpha * r / (1.0 + alpha - r)
                if not _accepted(z_atom, energy, sine2, np.random.random()):
                    continue
                cos_theta = 1.0 - 2.0 * sine2
                sin_theta = math.sqrt(max(0.0, 1.0 - cos_theta * cos_theta))
                cx, cy, cz = _turned(cx, cy, cz, cos_theta, sin_theta, 2.0 * math.pi * np.random.random())
