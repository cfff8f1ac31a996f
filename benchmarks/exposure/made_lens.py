"""Why the made lens sends 0.4454 and 0.4393 of the light through a pinhole, with an extinction ratio of 35.6.

The light of the written sizes at any bias and wall angle is that of :mod:`benchmarks.exposure.made_lens_sizes`;
:func:`rows` compares it with the propagation of the whole mask. The other factors come from the paper, from full-wave
rows of the lens, or are unknown and drawn from a stated range. A bias and a wall angle are excluded where no value of
the other factors within its range gives the measured efficiency.

``metafab benchmark made_lens`` prints it; ``python -m benchmarks.exposure.made_lens -o FOLDER`` writes
``made_lens.json`` and ``made_lens.png``.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator, RegularGridInterpolator
from scipy.ndimage import gaussian_filter

from benchmarks.exposure import made_lens_sizes
from benchmarks.exposure.made_lens_sizes import SLICES, TABLE_NM, WALLS_DEG, Sizes, SizeSums
from metafab import layout, library, optics
from metafab.core.conventions import FloatArray
from metafab.core.parallel.measure import measured
from metafab.core.parallel.work import Work
from metafab.core.storage.files import file_sha256, fingerprint
from metafab.core.storage.provenance import sources_sha256
from metafab.layout.pillars import PillarMap
from metafab.library.library import Library, inputs_of
from metafab.library.store import load, save
from metafab.optics.geometry.crystal import Crystal
from metafab.optics.measures.metrics import pinhole_efficiency
from metafab.phase import profile_of
from metafab.spec import Design, Substrate, load_design

DESIGN = Path(__file__).parents[2] / "layouts" / "helix_2mm.toml"
#: Bias of both sides, nm, on the grid of the mask's sizes.
BIAS_NM = np.arange(-30.0, 30.1, 2.0)
#: Wavelength, um, and one micrometre of the substrate's crystal.
_WAVELENGTH_UM = 0.8
_CRYSTAL = Crystal(Substrate(thickness_um=1.0, cut="r-plane"), _WAVELENGTH_UM)
#: Width of the band-pass filter, nm, and depth of the propagation, m.
_FILTER_NM, _DEPTH_M = 10.0, 0.30
#: Ranges of the other factors, each with its source. Uniform: nothing is known about where in the range they lie.
RANGES = {
    "neighbours": (0.945, 0.975),  # full-wave rows of the lens: 0.847 / 0.884 = 0.958 and 0.966
    "beam on the aperture": (0.865, 1.0),  # "spot size reduced to match the aperture": 1/e^2 diameter or smaller
    "wall_deg": (float(WALLS_DEG[0]), 90.0),  # from the horizontal, sizes as drawn at half height; not stated
    "roughness_nm": (0.0, 5.0),  # standard deviation of each pillar's size; not stated in the paper
    "azimuth_deg": (0.0, 45.0),  # rotation of the lens against the crystal; not stated
    "thickness_um": (400.0, 560.0),  # of usual 100 and 150 mm wafers; not stated
}
#: Uncertainties of what is known, each with its source; uniform. Proximity moves both sides without a correction.
KNOWN = {
    "silicon_n_shift": (-0.025, 0.0),  # eight published indices at 800 nm: 3.669 to 3.696, the library's is 3.6941
    "height_nm": (585.0, 615.0),  # 2.5 % of the film's thickness: an assumption
    "proximity_nm": (-2.0, 2.0),  # largest difference of printed and drawn size without correction
}
#: Light in the wrong image over that in the right one, without the crystal, each with its source; uniform.
UNWANTED = {
    "polariser": (0.0, 1e-3),  # stated: extinction above 1000
    # A block of 5 x 5 pillars (Meep): amplitude 0.065, 0.0042 of the light, 0.883 wanted. All of it in the wrong image.
    "cross-polarised light of neighbours": (0.0, 0.0048),
    "other image's pillars": (1.0 / 9860.0, 1.0 / 9860.0),  # the written file
}
#: Errors of alignment: of polariser against lens and of lens against crystal, and tilt of the wafer; deg, assumptions.
_ROTATION_DEG, _TILT_DEG = 2.0, 1.0
#: Thickness that changes the retardance as much as a degree of tilt: 0.041 waves of 3.26 in 460 um.
_UM_PER_DEG = 5.8
#: Relative error of propagation and solver, standard deviation: their target errors.
_NUMERICAL_ERROR = 5e-3
#: Reading error of a power meter, relative, standard deviation: an assumption.
_POWER_ERROR = 0.02
_DRAWS, _SEED = 400_000, 1


@dataclass(frozen=True)
class PrintedLens:
    """Shares of the light inside the substrate, mean of both polarisations unless stated."""

    wanted_x: float  #: In the target wave, x polarisation; likewise ``wanted_y``.
    wanted_y: float
    transmitted: float  #: Behind the pillars.
    straight: float  #: In the zero order, along the axis.

    @classmethod
    def of(
        cls, sums: SizeSums, sizes: Sizes, bias_x_nm: float = 0.0, bias_y_nm: float = 0.0, roughness_nm: float = 0.0
    ) -> PrintedLens:
        """The lens with a bias of width and length, and an independent normal error of both sides of each pillar."""
        steps = np.arange(-8, 9) * float(TABLE_NM[1] - TABLE_NM[0]) if roughness_nm > 0.0 else np.zeros(1)
        weight = np.exp(-0.5 * (steps / max(roughness_nm, 1e-9)) ** 2)
        mean, power = np.zeros((2, *sums.wanted.shape), dtype=np.complex128)
        for step, share in zip(steps, weight / weight.sum(), strict=True):
            t = sizes.at(sums.width_nm + bias_x_nm + step, sums.length_nm + bias_y_nm + step)
            mean, power = mean + share * t, power + share * np.abs(t) ** 2
        wanted = np.abs(np.sum(mean * sums.wanted, axis=0)) ** 2
        transmitted = float((sums.count[:, None] * power.real).sum() / 2.0)
        straight = float((np.abs((sums.count[:, None] * mean).sum(axis=0)) ** 2).mean())
        return cls(float(wanted[0]), float(wanted[1]), transmitted, straight)

    @property
    def wanted(self) -> float:
        """Mean of both polarisations."""
        return 0.5 * (self.wanted_x + self.wanted_y)


def pinhole_shares(design: Design) -> dict[str, float]:
    """Share of the target wave that passes the pinhole, at one wavelength and over the filter."""
    imaging = optics.Imaging.of(design)
    source = optics.ideal_field(profile_of(design), layout.lattice_of(design), design.device)
    shares = {}
    for name, filter_nm in (("one wavelength", None), ("filter", _FILTER_NM)):
        pair = optics.psf(
            source, imaging, [_DEPTH_M], optics.PsfNumerics(window_px=128, target_error=3e-3, filter_fwhm_nm=filter_nm)
        )
        shares[name] = float(pinhole_efficiency(pair).mean())
    return shares


def ghost_over_own(azimuth_deg: FloatArray, thickness_um: FloatArray) -> FloatArray:
    """Light that the crystal brings into the wrong image over the light in the right one, over the filter."""
    wavelengths = np.linspace(_WAVELENGTH_UM - 0.5e-3 * _FILTER_NM, _WAVELENGTH_UM + 0.5e-3 * _FILTER_NM, 9)
    per_um = np.array([_CRYSTAL.at_wavelength(float(w)).retardance_rad for w in wavelengths])
    crossed = (np.sin(0.5 * per_um[:, None] * np.ravel(thickness_um)) ** 2).mean(axis=0).reshape(thickness_um.shape)
    share = np.sin(2.0 * np.radians(azimuth_deg)) ** 2 * crossed
    return np.asarray(share / (1.0 - share))


@dataclass(frozen=True)
class Interval:
    """5, 50 and 95 % of the compatible draws."""

    low: float
    middle: float
    high: float

    @classmethod
    def of(cls, values: FloatArray, weight: FloatArray) -> Interval:
        """Weighted quantiles."""
        order = np.argsort(values)
        total = np.cumsum(weight[order]) / weight.sum()
        return cls(*(float(values[order][np.searchsorted(total, q)]) for q in (0.05, 0.5, 0.95)))


@dataclass(frozen=True)
class Explanation:
    """Shares of the light of a mask, tabulated over wall angle, roughness and bias."""

    wall_deg: FloatArray  #: Shape (n_wall,), ascending.
    roughness_nm: FloatArray  #: Shape (n_roughness,), ascending.
    bias_nm: FloatArray  #: Shape (n_bias,), ascending.
    #: Shape (n_wall, n_roughness, n_bias), share in the target wave, of the light inside the substrate.
    wanted: FloatArray
    transmitted: FloatArray  #: Share behind the pillars, in the shape of ``wanted``.
    straight: FloatArray  #: Share in the zero order, in the shape of ``wanted``.
    fixed: float  #: Factor that no draw changes: first face, and target wave through the pinhole over the filter.

    @classmethod
    def of(cls, sums: SizeSums, sizes: Sequence[Sizes], fixed: float) -> Explanation:
        """Compute the tables of a mask from the amplitudes at each wall angle."""
        roughness = np.linspace(*RANGES["roughness_nm"], 5)
        table = np.empty((3, WALLS_DEG.size, roughness.size, BIAS_NM.size))
        for wall, rough, bias in np.ndindex(*table.shape[1:]):
            at = float(BIAS_NM[bias])
            lens = PrintedLens.of(sums, sizes[wall], at, at, float(roughness[rough]))
            table[:, wall, rough, bias] = lens.wanted, lens.transmitted, lens.straight
        walls = np.arange(WALLS_DEG[0], WALLS_DEG[-1] + 0.1, 0.5)
        return cls(walls, roughness, BIAS_NM, *PchipInterpolator(WALLS_DEG, table, axis=1)(walls), fixed)

    def at(
        self, values: FloatArray, roughness_nm: FloatArray | float, bias_nm: FloatArray, wall_deg: FloatArray | float
    ) -> FloatArray:
        """One of the tables between its nodes, in the shape of ``bias_nm``."""
        places = np.broadcast_arrays(wall_deg, roughness_nm, bias_nm)
        table = RegularGridInterpolator((self.wall_deg, self.roughness_nm, self.bias_nm), values)
        return np.asarray(table(np.stack(places, axis=-1)))

    def draws(self, efficiency: float, extinction: float) -> dict[str, FloatArray]:
        """Random causes, and the weight of each: how well it explains the measured efficiency and extinction.

        Extinction is a limit: other unwanted light adds to the crystal's ghost.
        """
        rng = np.random.default_rng(_SEED)
        drawn = {name: rng.uniform(*span, _DRAWS) for name, span in RANGES.items()}
        drawn["bias_nm"] = rng.uniform(self.bias_nm[0], self.bias_nm[-1], _DRAWS)
        place = (drawn["roughness_nm"], drawn["bias_nm"], drawn["wall_deg"])
        ghost = ghost_over_own(drawn["azimuth_deg"], drawn["thickness_um"])
        before = self.fixed * drawn["neighbours"] * drawn["beam on the aperture"] / (1.0 + ghost)
        drawn["efficiency"] = before * self.at(self.wanted, *place)
        drawn["transmitted"] = self.at(self.transmitted, *place)
        drawn["straight"] = self.at(self.straight, *place)
        drawn["ghost"] = ghost
        misfit = (drawn["efficiency"] / efficiency - 1.0) / _POWER_ERROR
        drawn["weight"] = np.exp(-0.5 * misfit**2) * (ghost <= 1.0 / extinction)
        return drawn

    def misfit(self, efficiency: float, extinction: float) -> FloatArray:
        """Least distance of the measured efficiency from what the other factors' ranges allow, standard deviations.

        Returns:
            Shape (n_wall, n_bias); 0 where a value of each factor gives the measured efficiency.
        """
        factors = [RANGES[name] for name in ("neighbours", "beam on the aperture")]
        ghost = 1.0 / (1.0 + 1.0 / extinction)
        low = self.fixed * math.prod(low for low, _ in factors) * ghost * self.wanted.min(axis=1)
        high = self.fixed * math.prod(high for _, high in factors) * self.wanted.max(axis=1)
        beyond = np.maximum(np.maximum(low / efficiency - 1.0, 1.0 - high / efficiency), 0.0)
        return np.asarray(beyond / _POWER_ERROR)


def credible(drawn: Mapping[str, FloatArray]) -> tuple[FloatArray, FloatArray, FloatArray, tuple[float, float]]:
    """Density of the draws over bias and wall angle, and its contours.

    Returns:
        Edges of the cells along the bias, nm, and along the wall angle, degrees; weight of each cell, shape (n_bias,
        n_wall); and the least weights of the smallest sets that hold 95 and 68 % of it.
    """
    spans = [(BIAS_NM[0], BIAS_NM[-1]), RANGES["wall_deg"]]
    cells, bias_nm, wall_deg = np.histogram2d(
        drawn["bias_nm"], drawn["wall_deg"], bins=(60, 24), range=spans, weights=drawn["weight"]
    )
    cells = gaussian_filter(cells, 1.0, mode="nearest")
    ordered = np.sort(cells, axis=None)[::-1]
    within = np.cumsum(ordered) / ordered.sum()
    most, least = (float(ordered[np.searchsorted(within, share)]) for share in (0.683, 0.954))
    return bias_nm, wall_deg, cells, (least, most)


def mapped(design: Design, table: Library) -> tuple[SizeSums, PillarMap]:
    """The mask of a design."""
    profile = profile_of(design)
    pillars = layout.assign(profile, table, design).pillars
    return SizeSums.of(pillars, profile, design), pillars


@dataclass(frozen=True)
class Candidate:
    """One set of causes that gives the measured efficiency, and what three measurements would show."""

    name: str  #: Causes in words: pillars too small or too large, and what else.
    bias_nm: float  #: Printed less drawn size.
    wall_deg: float  #: Angle of the walls.
    roughness_nm: float  #: Standard deviation of the pillars' sizes.
    beam: float  #: Share of the measured input that falls on the aperture.
    efficiency: float  #: Through the pinhole, over the measured input.
    transmitted: float  #: Behind the pillars, over the light inside the substrate.
    straight: float  #: In the zero order, over the light inside the substrate.
    underfilled: float  #: Efficiency in a beam that is smaller than the aperture.


def candidates(known: Explanation, efficiency: float) -> list[Candidate]:
    """Sets of causes that each explain a measured efficiency; other factors are in the middle of their ranges."""
    found, neighbours = [], float(np.mean(RANGES["neighbours"]))
    overfilled = RANGES["beam on the aperture"][0]
    signs = (("too small", -1.0), ("too large", 1.0))
    for further, rough, beam, wall in (
        ("", 0.0, 1.0, 90.0),
        (", rough", 4.0, 1.0, 90.0),
        (", beam overfills", 0.0, overfilled, 90.0),
        (", walls of 88 degrees", 0.0, 1.0, 88.0),
        (", walls of 86 degrees", 0.0, 1.0, 86.0),
    ):
        for name, sign in signs:
            bias = sign * np.linspace(0.0, float(known.bias_nm[-1]), 601)
            place = rough, bias, wall
            through = known.fixed * neighbours * beam * known.at(known.wanted, *place)
            if through[0] < efficiency or through.min() > efficiency:
                continue
            best = int(np.flatnonzero(through <= efficiency)[0])
            shares = [float(known.at(values, *place)[best]) for values in (known.transmitted, known.straight)]
            reached = float(through[best])
            found.append(
                Candidate(name + further, float(bias[best]), wall, rough, beam, reached, *shares, reached / beam)
            )
    return found


@dataclass(frozen=True)
class MadeLens:
    """The made lens, explained."""

    measured: tuple[float, float, float]  #: Efficiencies x and y, and extinction ratio, of the paper.
    chain: dict[str, float]  #: Factors that are known, by name, from the written mask to the pinhole.
    predicted: float  #: Product of these factors.
    #: Efficiency that known factors and their uncertainties give, by what is included.
    predictions: dict[str, Interval]
    #: Extinction ratio that the known causes give, by the lens' rotation against the crystal.
    extinctions: dict[str, Interval]
    missing: float  #: Measured mean efficiency over ``predicted``.
    #: 5, 50 and 95 % of the compatible draws with pillars too small and too large, by wall angle; None where none is.
    bias_nm: dict[str, dict[str, Interval | None]]
    wall_deg: Interval  #: The same of the wall angle, over all biases.
    #: Lowest and highest bias, nm, that is not excluded by two standard errors, by wall angle.
    allowed_nm: dict[str, tuple[float, float]]
    wall_error: float  #: Relative error of the wanted share by the slices of a wall, at the most sloped one.
    #: Largest rotation against the crystal that the extinction allows, for several retardances.
    rotation_deg: dict[str, float]
    alone: dict[str, float]  #: Efficiency that the known factors and one further cause leave.
    candidates: list[Candidate]  #: Sets of causes, and what would tell them apart.
    better: dict[str, float]  #: Efficiency of a lens that does better, by step.
    unequal_bias_nm: float  #: Difference of width and length bias that alone explains x against y.


def explain(folder: Path, aperture_um: float) -> tuple[MadeLens, Explanation, dict[str, FloatArray]]:
    """The figures, the tables and the draws.

    Solved sizes are kept in a subfolder of ``folder``, until the unit cell or the code changes.
    """
    design = load_design(DESIGN)
    code = sources_sha256(("metafab.library.use.any_size",), ()), file_sha256(Path(made_lens_sizes.__file__))
    folder = folder / fingerprint(inputs_of(design.unit_cell), *code)[:12]
    assert design.measured is not None and design.measured.efficiency_x is not None
    measured_x, measured_y = design.measured.efficiency_x, float(design.measured.efficiency_y or 0.0)
    extinction = float(design.measured.extinction_ratio or 0.0)
    shares = pinhole_shares(design)
    design = replace(design, device=replace(design.device, aperture_um=aperture_um))
    with Work().processes() as executor:
        sizes = [Sizes.solved(design.unit_cell, wall, folder, executor) for wall in WALLS_DEG.tolist()]
        finer = Sizes.solved(design.unit_cell, float(WALLS_DEG[0]), folder, executor, 2 * SLICES)
        changes = [{"pillar_n_shift": shift} for shift in (-0.025, -0.0125)] + [
            {"height_nm": h} for h in (585.0, 615.0)
        ]
        changed = [Sizes.solved(design.unit_cell, 90.0, folder, executor, changed=change) for change in changes]
    if not (folder / "cell.h5").is_file():
        save(library.build(design.unit_cell), folder / "cell.h5")
    table = load(folder / "cell.h5")
    sums, _ = mapped(design, table)
    face = 4.0 * _CRYSTAL.n_ordinary / (1.0 + _CRYSTAL.n_ordinary) ** 2
    known = Explanation.of(sums, sizes, face * shares["filter"])
    plain, sloped = PrintedLens.of(sums, sizes[-1]), PrintedLens.of(sums, sizes[0])
    chain = {
        "wanted wave behind the written pillars": plain.wanted,
        "target wave through the pinhole": shares["one wavelength"],
        "filter of 10 nm": shares["filter"] / shares["one wavelength"],
        "first face of bare sapphire": face,
        "unlike neighbours (full-wave rows)": float(np.mean(RANGES["neighbours"])),
    }
    predicted = math.prod(chain.values())
    relative = [PrintedLens.of(sums, size).wanted / plain.wanted for size in changed]
    mean = 0.5 * (measured_x + measured_y)
    drawn = known.draws(mean, extinction)
    weight = drawn["weight"]
    biases: dict[str, dict[str, Interval | None]] = {}
    for wall in known.wall_deg[::-2].tolist():
        near = weight * (np.abs(drawn["wall_deg"] - wall) <= 0.5)
        signed = {"too small": near * (drawn["bias_nm"] < 0.0), "too large": near * (drawn["bias_nm"] > 0.0)}
        biases[f"{wall:g} degrees"] = {
            name: Interval.of(drawn["bias_nm"], part) if part.sum() > 0.01 * near.sum() else None
            for name, part in signed.items()
        }
    misfit = known.misfit(mean, extinction)[::2]
    allowed = {
        f"{wall:g} degrees": (float(BIAS_NM[beyond <= 2.0].min()), float(BIAS_NM[beyond <= 2.0].max()))
        for wall, beyond in zip(known.wall_deg[::2].tolist(), misfit, strict=True)
    }
    # Width and length by 2 nm more and less than a bias that explains the mean.
    low, high = (PrintedLens.of(sums, sizes[-1], -16.0 + d, -16.0 - d) for d in (-2.0, 2.0))
    per_nm = (high.wanted_x / high.wanted_y - low.wanted_x / low.wanted_y) / 8.0
    made = MadeLens(
        (measured_x, measured_y, extinction),
        chain,
        predicted,
        predictions(known, predicted, relative, extinction),
        extinctions(),
        mean / predicted,
        biases,
        Interval.of(drawn["wall_deg"], weight),
        allowed,
        abs(sloped.wanted / PrintedLens.of(sums, finer).wanted - 1.0),
        {f"{h:g} um": _largest_rotation_deg(h, extinction) for h in (430.0, 460.0, 500.0)},
        _alone(known, predicted, extinction),
        candidates(known, mean),
        _better(design, table, sizes[-1], shares["filter"], face),
        abs((measured_x / measured_y - 1.0) / per_nm),
    )
    return made, known, drawn


def predictions(
    known: Explanation, predicted: float, relative: Sequence[float], extinction: float
) -> dict[str, Interval]:
    """Propagate the uncertainties of the known factors by draws.

    ``relative`` are the wanted shares at silicon's index less 0.025 and 0.0125, and at heights of 585 and 615 nm, over
    that of the design.
    """
    rng = np.random.default_rng(_SEED)
    drawn = {name: rng.uniform(*span, _DRAWS) for name, span in (RANGES | KNOWN).items()}
    index, height = (
        PchipInterpolator(places, values)
        for places, values in (
            ([-0.025, -0.0125, 0.0], [*relative[:2], 1.0]),
            ([585.0, 600.0, 615.0], [relative[2], 1.0, relative[3]]),
        )
    )
    corrected = predicted * drawn["neighbours"] / float(np.mean(RANGES["neighbours"]))
    corrected *= index(drawn["silicon_n_shift"]) * height(drawn["height_nm"])
    corrected *= 1.0 + rng.normal(0.0, _NUMERICAL_ERROR, _DRAWS)
    shares = known.at(known.wanted, 0.0, np.append(drawn["proximity_nm"], 0.0), 90.0)
    plain = corrected * shares[:-1] / shares[-1]
    causes = plain * drawn["beam on the aperture"] / (1.0 + rng.uniform(0.0, 1.0 / extinction, _DRAWS))
    found = {"with correction": corrected, "without correction": plain, "with all known causes": causes}
    return {name: Interval.of(values, np.ones(_DRAWS)) for name, values in found.items()}


def extinctions() -> dict[str, Interval]:
    """Extinction ratio from the crystal, errors of alignment, and :data:`UNWANTED`, by draws."""
    rng = np.random.default_rng(_SEED)
    unwanted = np.tan(np.radians(rng.uniform(-_ROTATION_DEG, _ROTATION_DEG, _DRAWS))) ** 2
    for span in UNWANTED.values():
        unwanted += rng.uniform(*span, _DRAWS)
    thickness_um = rng.uniform(*RANGES["thickness_um"], _DRAWS) + _UM_PER_DEG * rng.uniform(
        -_TILT_DEG, _TILT_DEG, _DRAWS
    )
    error_deg = rng.uniform(-_ROTATION_DEG, _ROTATION_DEG, _DRAWS)
    rotations = {
        "aligned with the crystal": error_deg,
        "parallel to a flat at 45 degrees": 45.0 + error_deg,
        "at any rotation": rng.uniform(*RANGES["azimuth_deg"], _DRAWS),
    }
    none = np.ones(_DRAWS)
    return {
        name: Interval.of(1.0 / (unwanted + ghost_over_own(azimuth_deg, thickness_um)), none)
        for name, azimuth_deg in rotations.items()
    }


def _largest_rotation_deg(thickness_um: float, extinction: float) -> float:
    angles = np.linspace(0.0, 45.0, 4501)
    ghost = ghost_over_own(angles, np.full(angles.shape, thickness_um))
    return float(angles[np.flatnonzero(ghost <= 1.0 / extinction)[-1]])


def _alone(known: Explanation, predicted: float, extinction: float) -> dict[str, float]:
    """Efficiency that the known factors and one further cause at the end of its range leave."""

    def of(roughness_nm: float, bias_nm: float, wall_deg: float = 90.0) -> float:
        return float(known.at(known.wanted, roughness_nm, np.array([bias_nm]), wall_deg)[0])

    none = of(0.0, 0.0)
    shares = {
        "roughness of 5 nm": of(RANGES["roughness_nm"][1], 0.0),
        "proximity without correction (2 nm everywhere)": min(of(0.0, b) for b in (-2.0, 2.0)),
        "bias of -10 nm": of(0.0, -10.0),
        "bias of +10 nm": of(0.0, 10.0),
        **{f"walls of {wall:g} degrees": of(0.0, 0.0, wall) for wall in WALLS_DEG[-2::-1].tolist()},
    }
    return {
        "nothing further": predicted,
        "beam that fills the aperture to its 1/e^2 diameter": predicted * RANGES["beam on the aperture"][0],
        "crystal, as far as the extinction ratio allows": predicted / (1.0 + 1.0 / extinction),
        **{name: predicted * share / none for name, share in shares.items()},
    }


def _better(design: Design, table: Library, sizes: Sizes, pinhole: float, face: float) -> dict[str, float]:
    """Efficiency of the lens and of one mapped for a bias of 10 nm, by what else is done, at three biases."""
    neighbours, result = float(np.mean(RANGES["neighbours"])), {}
    robust = replace(design, rules=replace(design.rules, cd_sigma_nm=10.0))
    for name, lens in (("as written", design), ("mapped for a bias of 10 nm rms", robust)):
        sums, _ = mapped(lens, table)
        for bias in (-10.0, 0.0, 10.0):
            wanted = PrintedLens.of(sums, sizes, bias, bias).wanted
            result[f"{name}, bias {bias:+g} nm"] = wanted * pinhole * face * neighbours
            result[f"{name}, bias {bias:+g} nm, coated back face"] = wanted * pinhole * neighbours
    return result


def draw(made: MadeLens, known: Explanation, drawn: dict[str, FloatArray], path: Path) -> None:
    """Four panels: efficiency against bias; joint map of bias and wall angle; what would tell sets apart; crystal."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(11.0, 8.0), constrained_layout=True)
    middle, mean = float(np.mean(RANGES["neighbours"])), 0.5 * (made.measured[0] + made.measured[1])
    efficiency, joint, told, crystal = axes.ravel()
    for wall, row in list(zip(known.wall_deg, known.wanted[:, 0], strict=True))[::-4]:
        efficiency.plot(known.bias_nm, row * known.fixed * middle, label=f"walls of {wall:g}°")
    efficiency.plot(known.bias_nm, known.wanted[-1, -1] * known.fixed * middle, "--", label="90°, roughness 5 nm")
    for value in made.measured[:2]:
        efficiency.axhline(value, color="black", linewidth=0.8)
    efficiency.set(xlabel="bias of both sides / nm", ylabel="efficiency through the pinhole", title="All known factors")
    efficiency.set_ylim(0.15, 0.93)
    efficiency.legend(ncols=2, loc="upper center", fontsize="small")
    excluded = known.misfit(mean, made.measured[2])
    joint.contourf(known.bias_nm, known.wall_deg, excluded, levels=[2.0, 1e9], colors=["0.85"])
    bias_nm, wall_deg, cells, levels = credible(drawn)
    centres = [0.5 * (edges[1:] + edges[:-1]) for edges in (bias_nm, wall_deg)]
    joint.contourf(*centres, cells.T, levels=[*levels, cells.max()], colors=["#b7d3ee", "#3f7fbf"])
    for case in made.candidates:
        joint.plot(case.bias_nm, case.wall_deg, "k+")
    joint.set(xlabel="bias / nm", ylabel="wall angle / °", title="68 and 95 % of the draws; grey: excluded (2 σ)")
    weight = drawn["weight"] / drawn["weight"].max()
    kept = np.flatnonzero(np.random.default_rng(_SEED).uniform(size=_DRAWS) < weight)[:4000]
    shown = told.scatter(
        drawn["transmitted"][kept],
        drawn["straight"][kept],
        3,
        drawn["bias_nm"][kept],
        cmap="coolwarm",
        vmin=-20,
        vmax=20,
    )
    figure.colorbar(shown, ax=told, label="bias / nm")
    told.set(xlabel="behind the pillars, in all", ylabel="zero order on the axis", title="Compatible draws")
    azimuth, thickness = np.meshgrid(np.linspace(0.0, 45.0, 181), np.linspace(*RANGES["thickness_um"], 161))
    allowed = ghost_over_own(azimuth, thickness) <= 1.0 / made.measured[2]
    crystal.contourf(azimuth, thickness, allowed, levels=[0.5, 1.5], colors=["tab:blue"])
    crystal.set(xlabel="rotation against the crystal / °", ylabel="thickness / µm", title="Compatible with 35.6")
    figure.savefig(path, dpi=90)
    plt.close(figure)


def rows(quick: bool) -> list[dict[str, Any]]:
    """The sums by size against the propagation of the whole mask, ``error`` the difference of efficiencies.

    Unless ``quick``, a row follows for each known factor, for each cause alone, and for each set of causes.
    """
    design = load_design(DESIGN)
    design = replace(design, device=replace(design.device, aperture_um=200.0 if quick else 1000.0))
    table = library.build(design.unit_cell)
    profile = profile_of(design)
    pillars = layout.assign(profile, table, design).pillars
    imaging, numerics = optics.Imaging.of(design), optics.PsfNumerics(window_px=128, target_error=3e-3)
    ideal = optics.ideal_field(profile, layout.lattice_of(design), design.device)
    of_target = float(pinhole_efficiency(optics.psf(ideal, imaging, [_DEPTH_M], numerics)).mean())
    with measured() as cost:
        sums = SizeSums.of(pillars, profile, design)
        t = optics.written_field(pillars, table).table[1:]
        summed = float((np.abs(np.sum(t * sums.wanted, axis=0)) ** 2).mean()) * of_target
    pair = optics.psf(optics.written_field(pillars, table), imaging, [_DEPTH_M], numerics)
    whole = float(pinhole_efficiency(pair).mean())
    check = {
        "name": f"{design.device.aperture_um:g} um, efficiency by sums over sizes",
        "error": abs(summed - whole),
        "seconds": cost.seconds,
        "peak_rss_mb": cost.peak_rss_mb,
        "efficiency": summed,
        "propagated": whole,
    }
    if quick:
        return [check]
    with TemporaryDirectory() as folder:
        made = explain(Path(folder), design.device.aperture_um)[0]
    factors = [{"name": f"factor: {name}", "factor": factor} for name, factor in made.chain.items()]
    factors += [{"name": f"predicted {name}", **asdict(value)} for name, value in made.predictions.items()]
    factors += [{"name": f"extinction ratio {name}", **asdict(value)} for name, value in made.extinctions.items()]
    alone = [{"name": f"known factors and {name}", "efficiency": value} for name, value in made.alone.items()]
    sets = [{**asdict(case), "name": f"explains the made lens: {case.name}"} for case in made.candidates]
    return [check, *factors, *alone, *sets]


def main() -> None:
    """Write ``made_lens.json`` and ``made_lens.png``."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--aperture-um", type=float, default=2000.0, help="part of the lens whose sizes are summed")
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    made, known, drawn = explain(arguments.output, arguments.aperture_um)
    text = json.dumps(asdict(made), indent=1)
    (arguments.output / "made_lens.json").write_text(text, encoding="utf-8")
    draw(made, known, drawn, arguments.output / "made_lens.png")
    print(text)


if __name__ == "__main__":
    main()
