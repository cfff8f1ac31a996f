"""Why the made lens sends 0.4454 and 0.4393 of the light through a pinhole, with an extinction ratio of 35.6.

The light of a mask is the target wave times c, plus a rest that hardly enters the pinhole: c is the mean over all sites
of the pillars' amplitude times the conjugate target wave. Sums of the target wave over the sites of each size turn this
into a sum over a few thousand sizes, so that any bias takes a millisecond. :func:`rows` compares it with
the propagation of the whole mask. The other factors come from the paper, from full-wave rows of the lens, or are
unknown and drawn from a stated range.

``metafab benchmark made_lens`` prints it; ``python -m benchmarks.made_lens -o FOLDER`` writes ``made_lens.json`` and
``made_lens.png``.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from metafab import layout, library, optics
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.parallel.measure import measured
from metafab.layout.pillars import PillarMap
from metafab.library.library import Library
from metafab.library.store import load, save
from metafab.library.use.amplitudes import power_amplitudes
from metafab.optics.geometry.crystal import Crystal
from metafab.optics.measures.metrics import pinhole_efficiency
from metafab.phase import profile_of
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Design, Substrate, load_design
from metafab.tolerance import corner_fields

DESIGN = Path(__file__).parents[1] / "layouts" / "helix_2mm.toml"
#: Wall angles, degrees, of walls that slope and are otherwise as drawn at half height.
WALLS_DEG = (88.0, 86.0, 84.0)
#: Bias of both sides, nm, on the grid of the mask's sizes.
BIAS_NM = np.arange(-30.0, 30.1, 2.0)
#: Sizes of the library that is solved, nm, its step and error; and of the tables: mask sizes, biased by up to 30 nm.
_SOLVED_NM, _SOLVED_STEP_NM, _TARGET_ERROR = (70.0, 290.0), 5.0, 1e-2
_TABLE_NM = np.arange(70.0, 280.1, 2.0)
#: Wavelength, um, and one micrometre of the substrate's crystal.
_WAVELENGTH_UM = 0.8
_CRYSTAL = Crystal(Substrate(thickness_um=1.0, cut="r-plane"), _WAVELENGTH_UM)
#: Width of the band-pass filter, nm, and depth of the propagation, m.
_FILTER_NM, _DEPTH_M = 10.0, 0.30
#: Ranges of the other factors, each with its source. Uniform: nothing is known about where in the range they lie.
RANGES = {
    "neighbours": (0.945, 0.975),  # full-wave rows of the lens: 0.847 / 0.884 = 0.958 and 0.966
    "beam on the aperture": (0.865, 1.0),  # "spot size reduced to match the aperture": 1/e^2 diameter or smaller
    "roughness_nm": (0.0, 5.0),  # standard deviation of each pillar's size; not stated in the paper
    "azimuth_deg": (0.0, 45.0),  # rotation of the lens against the crystal; not stated
    "thickness_um": (400.0, 560.0),  # of usual 100 and 150 mm wafers; not stated
}
#: Reading error of a power meter, relative, standard deviation: an assumption.
_POWER_ERROR = 0.02
_DRAWS, _SEED = 400_000, 1


@dataclass(frozen=True)
class SizeSums:
    """Sums over the sites of each pillar size, which give the light in the target wave."""

    width_nm: FloatArray  #: Shape (n,), distinct sizes.
    length_nm: FloatArray  #: Shape (n,).
    count: FloatArray  #: Shape (n,), pillars of each size over the number of sites inside the aperture.
    wanted: ComplexArray  #: Shape (n, 2), mean over all sites of the conjugate target wave on the sites of each size.

    @classmethod
    def of(cls, pillars: PillarMap, profile: PhaseProfile, design: Design) -> SizeSums:
        """Add up the sites of a mask, tile by tile."""
        sizes = pillars.size_nm()
        count = np.zeros(len(sizes))
        real, imag = np.zeros((2, len(sizes), 2))
        sites, x, y = 0, pillars.lattice.x_um(), pillars.lattice.y_um()
        for tile in pillars.tiles():
            n_y, n_x = tile.size_index.shape
            columns, rows = x[tile.column : tile.column + n_x], y[tile.row : tile.row + n_y]
            sites += int(design.device.encloses(columns, rows).sum())
            index, target_rad = tile.size_index.ravel(), profile(columns, rows)
            count += np.bincount(index, minlength=len(sizes))
            for p in (0, 1):
                real[:, p] += np.bincount(index, np.cos(target_rad[p]).ravel(), len(sizes))
                imag[:, p] -= np.bincount(index, np.sin(target_rad[p]).ravel(), len(sizes))
        wanted = (real + 1j * imag) / sites
        return cls(sizes[1:, 0], sizes[1:, 1], count[1:] / sites, wanted[1:])


@dataclass(frozen=True)
class Sizes:
    """Amplitudes of all sizes that a bias reaches."""

    t: ComplexArray  #: Shape (n_length, n_width, 2), per square root of the flux, on the grid of the table.

    def at(self, width_nm: FloatArray, length_nm: FloatArray) -> ComplexArray:
        """Amplitudes of sizes on the table's grid (those beyond its ends take its ends), shape (n, 2)."""
        step = float(_TABLE_NM[1] - _TABLE_NM[0])
        places = [np.rint((side - _TABLE_NM[0]) / step).astype(int) for side in (length_nm, width_nm)]
        row, column = (np.clip(place, 0, _TABLE_NM.size - 1) for place in places)
        return np.asarray(self.t[row, column])


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
        steps = np.arange(-8, 9) * float(_TABLE_NM[1] - _TABLE_NM[0]) if roughness_nm > 0.0 else np.zeros(1)
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


def wide_library(design: Design, folder: Path) -> Library:
    """Library of the unit cell over all sizes that a bias reaches, on the table's grid; kept in ``folder``."""
    path = folder / "wide.h5"
    if not path.is_file():
        cell = design.unit_cell
        sweep = {"width_nm": _SOLVED_NM, "length_nm": _SOLVED_NM, "size_grid_nm": _SOLVED_STEP_NM}
        solved = library.build(replace(cell, sweep=replace(cell.sweep, **sweep, target_error=_TARGET_ERROR)))
        save(solved, path)
    solved = load(path)
    there = solved.surface(*np.meshgrid(_TABLE_NM, _TABLE_NM))
    t = [np.asarray(part)[None] for part in (there.t_xx, there.t_yy)]
    error = np.asarray(there.error)
    return replace(
        solved, width_nm=_TABLE_NM, length_nm=_TABLE_NM, t_xx=t[0], t_yy=t[1], error=error, model_error=error
    )


def all_sizes(wide: Library) -> Sizes:
    """Table of a library on the table's grid."""
    width, length = (side.ravel() for side in np.meshgrid(_TABLE_NM, _TABLE_NM))
    return Sizes(power_amplitudes(wide, width, length).reshape(_TABLE_NM.size, _TABLE_NM.size, 2))


def with_slopes(sums: SizeSums, pillars: PillarMap, table: Library) -> dict[float, tuple[float, float]]:
    """Wanted share with sloped walls and no bias, and the bound of its error by that of the amplitudes, by angle."""
    written, shares = optics.written_field(pillars, table), {}
    for angle in WALLS_DEG:
        corner = corner_fields(written, table, {"sidewall_angle_deg": 90.0 - angle})[0]
        wanted = np.abs(np.sum(corner.field.table[1:] * sums.wanted, axis=0)) ** 2
        # First order: all of the amplitudes' error in phase with the wanted wave.
        shares[angle] = float(wanted.mean()), 2.0 * corner.error * float(wanted.mean())
    return shares


def pinhole_shares(design: Design) -> dict[str, float]:
    """Share of the target wave that passes the pinhole, at one wavelength and over the filter."""
    imaging = optics.Imaging.of(design)
    source = optics.ideal_field(profile_of(design), layout.lattice_of(design), design.device)
    shares = {}
    for name, filter_nm in (("one wavelength", None), ("filter", _FILTER_NM)):
        pair = optics.psf(source, imaging, [_DEPTH_M], optics.PsfNumerics(128, 3e-3, filter_nm))
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
    """Shares of the light of a mask, tabulated over roughness and bias for vertical walls."""

    roughness_nm: FloatArray  #: Shape (n_roughness,), ascending.
    bias_nm: FloatArray  #: Shape (n_bias,), ascending.
    wanted: FloatArray  #: Shape (n_roughness, n_bias), share in the target wave, of the light inside the substrate.
    transmitted: FloatArray  #: Shape (n_roughness, n_bias), share behind the pillars.
    straight: FloatArray  #: Shape (n_roughness, n_bias), share in the zero order.
    fixed: float  #: Factor that no draw changes: first face, and target wave through the pinhole over the filter.

    @classmethod
    def of(cls, sums: SizeSums, sizes: Sizes, fixed: float) -> Explanation:
        """Compute the tables of a mask."""
        roughness = np.linspace(*RANGES["roughness_nm"], 5)
        table = np.empty((3, roughness.size, BIAS_NM.size))
        for place in np.ndindex(*table.shape[1:]):
            bias, rough = float(BIAS_NM[place[1]]), float(roughness[place[0]])
            lens = PrintedLens.of(sums, sizes, bias, bias, rough)
            table[:, *place] = lens.wanted, lens.transmitted, lens.straight
        return cls(roughness, BIAS_NM, *table, fixed)

    def at(self, values: FloatArray, roughness_nm: FloatArray, bias_nm: FloatArray) -> FloatArray:
        """One of the tables between its nodes."""
        table = RegularGridInterpolator((self.roughness_nm, self.bias_nm), values)
        return np.asarray(table(np.stack([roughness_nm, bias_nm], axis=-1)))

    def draws(self, efficiency: float, extinction: float) -> dict[str, FloatArray]:
        """Random causes, and the weight of each: how well it explains the measured efficiency and extinction.

        Extinction is a limit: other unwanted light adds to the crystal's ghost.
        """
        rng = np.random.default_rng(_SEED)
        drawn = {name: rng.uniform(*span, _DRAWS) for name, span in RANGES.items()}
        drawn["bias_nm"] = rng.uniform(self.bias_nm[0], self.bias_nm[-1], _DRAWS)
        place = (drawn["roughness_nm"], drawn["bias_nm"])
        ghost = ghost_over_own(drawn["azimuth_deg"], drawn["thickness_um"])
        before = self.fixed * drawn["neighbours"] * drawn["beam on the aperture"] / (1.0 + ghost)
        drawn["efficiency"] = before * self.at(self.wanted, *place)
        drawn["transmitted"] = self.at(self.transmitted, *place)
        drawn["straight"] = self.at(self.straight, *place)
        drawn["ghost"] = ghost
        misfit = (drawn["efficiency"] / efficiency - 1.0) / _POWER_ERROR
        drawn["weight"] = np.exp(-0.5 * misfit**2) * (ghost <= 1.0 / extinction)
        return drawn


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
    for name, rough, beam, sign in (
        ("too small", 0.0, 1.0, -1.0),
        ("too large", 0.0, 1.0, 1.0),
        ("too small, rough", 4.0, 1.0, -1.0),
        ("too large, rough", 4.0, 1.0, 1.0),
        ("too small, beam overfills", 0.0, overfilled, -1.0),
        ("too large, beam overfills", 0.0, overfilled, 1.0),
    ):
        bias = sign * np.linspace(0.0, float(known.bias_nm[-1]), 601)
        place = np.full(bias.shape, rough), bias
        through = known.fixed * neighbours * beam * known.at(known.wanted, *place)
        if through[0] < efficiency or through.min() > efficiency:
            continue
        best = int(np.flatnonzero(through <= efficiency)[0])
        shares = [float(known.at(values, *place)[best]) for values in (known.transmitted, known.straight)]
        reached = float(through[best])
        found.append(Candidate(name, float(bias[best]), rough, beam, reached, *shares, reached / beam))
    return found


@dataclass(frozen=True)
class MadeLens:
    """The made lens, explained."""

    measured: tuple[float, float, float]  #: Efficiencies x and y, and extinction ratio, of the paper.
    chain: dict[str, float]  #: Factors that are known, by name, from the written mask to the pinhole.
    predicted: float  #: Product of these factors.
    missing: float  #: Measured mean efficiency over ``predicted``.
    #: 5, 50 and 95 % of the compatible draws with pillars too small and too large; None where none is.
    bias_nm: dict[str, Interval | None]
    #: Largest rotation against the crystal that the extinction allows, for several retardances.
    rotation_deg: dict[str, float]
    alone: dict[str, float]  #: Efficiency that the known factors and one further cause leave.
    candidates: list[Candidate]  #: Sets of causes, and what would tell them apart.
    better: dict[str, float]  #: Efficiency of a lens that does better, by step.
    unequal_bias_nm: float  #: Difference of width and length bias that alone explains x against y.


def explain(folder: Path, aperture_um: float) -> tuple[MadeLens, Explanation, dict[str, FloatArray]]:
    """The figures, the tables and the draws; libraries are kept in ``folder``."""
    design = load_design(DESIGN)
    assert design.measured is not None and design.measured.efficiency_x is not None
    measured_x, measured_y = design.measured.efficiency_x, float(design.measured.efficiency_y or 0.0)
    extinction = float(design.measured.extinction_ratio or 0.0)
    shares = pinhole_shares(design)
    design = replace(design, device=replace(design.device, aperture_um=aperture_um))
    sizes = all_sizes(wide_library(design, folder))
    if not (folder / "cell.h5").is_file():
        save(library.build(design.unit_cell), folder / "cell.h5")
    table = load(folder / "cell.h5")
    sums, pillars = mapped(design, table)
    face = 4.0 * _CRYSTAL.n_ordinary / (1.0 + _CRYSTAL.n_ordinary) ** 2
    known = Explanation.of(sums, sizes, face * shares["filter"])
    plain = PrintedLens.of(sums, sizes)
    chain = {
        "wanted wave behind the written pillars": plain.wanted,
        "target wave through the pinhole": shares["one wavelength"],
        "filter of 10 nm": shares["filter"] / shares["one wavelength"],
        "first face of bare sapphire": face,
        "unlike neighbours (full-wave rows)": float(np.mean(RANGES["neighbours"])),
    }
    predicted = math.prod(chain.values())
    mean = 0.5 * (measured_x + measured_y)
    drawn = known.draws(mean, extinction)
    weight = drawn["weight"]
    signed = {"too small": weight * (drawn["bias_nm"] < 0.0), "too large": weight * (drawn["bias_nm"] > 0.0)}
    # Width and length by 2 nm more and less than a bias that explains the mean.
    low, high = (PrintedLens.of(sums, sizes, -16.0 + d, -16.0 - d) for d in (-2.0, 2.0))
    per_nm = (high.wanted_x / high.wanted_y - low.wanted_x / low.wanted_y) / 8.0
    made = MadeLens(
        (measured_x, measured_y, extinction),
        chain,
        predicted,
        mean / predicted,
        {name: Interval.of(drawn["bias_nm"], part) if part.sum() > 0 else None for name, part in signed.items()},
        {f"{h:g} um": _largest_rotation_deg(h, extinction) for h in (430.0, 460.0, 500.0)},
        _alone(known, predicted, extinction, with_slopes(sums, pillars, table)),
        candidates(known, mean),
        _better(design, table, sizes, shares["filter"], face),
        abs((measured_x / measured_y - 1.0) / per_nm),
    )
    return made, known, drawn


def _largest_rotation_deg(thickness_um: float, extinction: float) -> float:
    angles = np.linspace(0.0, 45.0, 4501)
    ghost = ghost_over_own(angles, np.full(angles.shape, thickness_um))
    return float(angles[np.flatnonzero(ghost <= 1.0 / extinction)[-1]])


def _alone(
    known: Explanation, predicted: float, extinction: float, slopes: Mapping[float, tuple[float, float]]
) -> dict[str, float]:
    """Efficiency that the known factors and one further cause at the end of its range leave."""
    none = float(known.at(known.wanted, np.zeros(1), np.zeros(1))[0])

    def of(roughness_nm: float, bias_nm: float) -> float:
        return float(predicted * known.at(known.wanted, np.array([roughness_nm]), np.array([bias_nm]))[0] / none)

    sloped = {}
    for angle, (wanted, error) in slopes.items():
        sloped[f"walls of {angle:g} degrees"] = predicted * wanted / none
        sloped[f"walls of {angle:g} degrees, error"] = predicted * error / none
    return {
        "nothing further": predicted,
        "beam that fills the aperture to its 1/e^2 diameter": predicted * RANGES["beam on the aperture"][0],
        "crystal, as far as the extinction ratio allows": predicted / (1.0 + 1.0 / extinction),
        "roughness of 5 nm": of(RANGES["roughness_nm"][1], 0.0),
        "proximity without correction (2 nm everywhere)": min(of(0.0, b) for b in (-2.0, 2.0)),
        "bias of -10 nm": of(0.0, -10.0),
        "bias of +10 nm": of(0.0, 10.0),
        **sloped,
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
    """Three panels: efficiency against bias, compatible bias and roughness, compatible rotation and thickness."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(13.0, 4.0), constrained_layout=True)
    middle = float(np.mean(RANGES["neighbours"]))
    for rough, row in zip(known.roughness_nm[::2], known.wanted[::2], strict=True):
        axes[0].plot(known.bias_nm, row * known.fixed * middle, label=f"roughness {rough:g} nm")
    for value in made.measured[:2]:
        axes[0].axhline(value, color="black", linewidth=0.8)
    axes[0].set(xlabel="bias of both sides / nm", ylabel="efficiency through the pinhole", title="All known factors")
    axes[0].legend()
    axes[1].hist2d(drawn["bias_nm"], drawn["roughness_nm"], bins=(60, 25), weights=drawn["weight"], cmap="Blues")
    axes[1].set(xlabel="bias / nm", ylabel="roughness / nm", title="Compatible with 0.4454 and 0.4393")
    azimuth, thickness = np.meshgrid(np.linspace(0.0, 45.0, 181), np.linspace(*RANGES["thickness_um"], 161))
    allowed = ghost_over_own(azimuth, thickness) <= 1.0 / made.measured[2]
    axes[2].contourf(azimuth, thickness, allowed, levels=[0.5, 1.5], colors=["tab:blue"])
    axes[2].set(xlabel="rotation against the crystal / °", ylabel="thickness / µm", title="Compatible with 35.6")
    figure.savefig(path, dpi=110)
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
    imaging, numerics = optics.Imaging.of(design), optics.PsfNumerics(128, 3e-3)
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
