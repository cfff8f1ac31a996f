"""Most light that sizes can send into the wanted orders of a lens' rows, by a search with the model of neighbours.

    python -m benchmarks.mask.neighbour_rows DESIGN.toml [--rows 6] [--starts 16] [--limit-rad 0.03] [--seed 1]
        [--resolution 3] [--meep 16 24]

Rows lie at random places of the lens and hold one turn or more of each polarisation's phase; each is closed to a
period. In a closed row the light of any size at one site follows exactly from that site's block of the inverse of the
row's matrix. Each site in turn takes the best of the sizes that suit lone pillars best there, until none moves.
Searches start from the sizes for lone pillars, from random ones among the best, and from the best row found with new
sizes at a few sites. The library lies beside the design's unit cell.

With ``--resolution`` the sizes for lone pillars and the best ones of each row are also solved by spectral elements of
that resolution: keys ``full wave``, with the largest phase of the best row's orders about their targets. With 3 this
takes from half a minute of processor time for 16 pillars to two for 24. ``--meep`` adds Meep on grids of so many pixels
a period: its coupling of neighbours, without the grid's error of each pillar alone, is added to the library's field.
For 16 pillars and both kinds of sizes 24 pixels take some 20 minutes.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metafab import library, phase
from metafab.cell.elements.solve import orders_at
from metafab.cell.meep import SupercellSettings
from metafab.cell.meep.supercell import solve_supercell
from metafab.cell.pillar import PillarCell
from metafab.cell.supercell import Supercell
from metafab.core.conventions import POLARISATIONS, ComplexArray, FloatArray
from metafab.fullwave.blocks import lone_orders
from metafab.fullwave.written import site_cell
from metafab.layout.assign import mapping_of
from metafab.layout.mapping import TileMapping
from metafab.library import Library
from metafab.library.neighbours import require_neighbours
from metafab.library.neighbours.line import LineModel
from metafab.library.neighbours.solve import uniform_field
from metafab.library.use.amplitudes import power_ratio_of
from metafab.spec import load_design

Sizes = NDArray[np.intp]

#: Sizes tried at each site; sites per row, and how far its phases may be from whole turns, in turns.
_TRIED, _SITES, _FROM_WHOLE = 800, (13, 25), 0.2
#: Loss of light per squared rad that a phase is beyond its limit.
_PHASE_PRICE = 20.0


class _Solved(NamedTuple):
    """A closed row in light of one polarisation."""

    sum: complex  #: F, sum of w_m t_m.
    inverse: ComplexArray  #: Shape (n, modes, modes), blocks of the inverse on the diagonal.
    amplitude: ComplexArray  #: Shape (n, modes).
    adjoint: ComplexArray  #: Shape (n, modes).


@dataclass(frozen=True)
class _Light:
    """The chain of one polarisation, at all sizes; arrays of shape (sizes, ...)."""

    model: LineModel
    terms: FloatArray
    site: ComplexArray  #: H.
    source: ComplexArray  #: c.
    own: ComplexArray  #: e, 0 for odd modes.
    side: ComplexArray  #: g.
    t: ComplexArray
    rest: ComplexArray  #: t - y.

    @classmethod
    def of(cls, model: LineModel, size_nm: FloatArray, t: ComplexArray) -> _Light:
        """Chain at sizes, shape (sizes, 2), with the library's t, shape (sizes,)."""
        terms, odd = model.polynomials(size_nm), ((0, 0), (0, model.shape.odd))
        source, own = (np.pad(terms @ each, odd) for each in (model.source, model.own))
        return cls(
            model, terms, model.site_matrix(terms), source, own, terms @ model.side, t, t - uniform_field(model, terms)
        )

    def taps(self, weight: ComplexArray, site: int, size: Sizes) -> ComplexArray:
        """Light that the modes of a site add to F, shape (sizes, modes)."""
        after, before = weight[(site + 1) % weight.size], weight[site - 1]
        return np.asarray(weight[site] * self.own[size] + (after + before * self.model.shape.parity) * self.side[size])

    def solve(self, weight: ComplexArray, row: Sizes) -> _Solved:
        """Solve a closed row."""
        count, modes = row.size, self.model.shape.modes
        taps = np.concatenate([self.taps(weight, m, row[m : m + 1]) for m in range(count)])
        inverse = np.asarray(np.linalg.inv(self.model.periodic_matrix(self.terms[row])), dtype=np.complex128)
        amplitude, adjoint = (inverse @ self.source[row].ravel()), (inverse.T @ taps.ravel())
        blocks = inverse.reshape(count, modes, count, modes)[range(count), :, range(count)]
        total = complex(taps.ravel() @ amplitude + weight @ self.rest[row])
        return _Solved(total, blocks, amplitude.reshape(count, modes), adjoint.reshape(count, modes))

    def replaced(self, weight: ComplexArray, row: Sizes, solved: _Solved, site: int, tried: Sizes) -> ComplexArray:
        """F with each of the sizes ``tried`` at a site, shape (tried,)."""
        now, block = row[site : site + 1], np.linalg.inv(solved.inverse[site])
        around = block - self.site[now[0]]
        into = block @ solved.amplitude[site] - self.source[now[0]]
        out = block.T @ solved.adjoint[site] - self.taps(weight, site, now)[0]
        both = np.concatenate([now, tried])
        amplitude = np.linalg.solve(self.site[both] + around, (self.source[both] + into)[..., None])[..., 0]
        light = np.sum((self.taps(weight, site, both) + out) * amplitude, axis=1) + weight[site] * self.rest[both]
        return np.asarray(solved.sum + light[1:] - light[0])


@dataclass(frozen=True)
class _Row:
    """A closed row of a lens."""

    lights: tuple[_Light, _Light]
    weight: ComplexArray  #: Shape (2, n), exp(-i target).
    limit_rad: float  #: Largest phase of an order.
    ratio: float  #: Power over squared amplitude.

    @property
    def lone(self) -> FloatArray:
        """Overlap of lone pillars with the target, shape (n, sizes)."""
        return np.asarray(sum(np.outer(w, light.t).real for w, light in zip(self.weight, self.lights, strict=True)))

    def score(self, sums: Any) -> FloatArray:
        """Mean light of both orders less the price of their phases, from F, shape (2, ...)."""
        mean = np.asarray(sums) / self.weight.shape[1]
        beyond = np.maximum(0.0, np.abs(np.angle(mean)) - self.limit_rad)
        return np.asarray(self.light(mean) - _PHASE_PRICE * (beyond**2).sum(axis=0))

    def light(self, mean: ComplexArray) -> FloatArray:
        """Mean light of both orders of amplitudes ``mean``, shape (2, ...)."""
        return np.asarray((np.abs(mean) ** 2).mean(axis=0) * self.ratio)

    def solve(self, row: Sizes) -> list[_Solved]:
        """Both polarisations."""
        return [light.solve(w, row) for w, light in zip(self.weight, self.lights, strict=True)]

    def ascended(self, row: Sizes, count: int = _TRIED) -> tuple[Sizes, float]:
        """Row in which none of the best ``count`` sizes of lone pillars does better at any site, and its score."""
        row, moved = row.copy(), True
        tried = np.argpartition(-self.lone, count, axis=1)[:, :count]
        solved = self.solve(row)
        best = float(self.score([each.sum for each in solved]))
        while moved:
            moved = False
            for site, sizes in enumerate(tried):
                parts = zip(self.weight, self.lights, solved, strict=True)
                scores = self.score([light.replaced(w, row, each, site, sizes) for w, light, each in parts])
                if scores.max() > best + 1e-9:
                    row[site], moved = sizes[scores.argmax()], True
                    solved = self.solve(row)
                    best = float(self.score([each.sum for each in solved]))
        return row, best

    def searched(self, starts: int, seed: int) -> tuple[Sizes, float]:
        """Best row of a search from the sizes for lone pillars, and two searches for each of ``starts``."""
        rng, lone = np.random.default_rng(seed), self.lone
        best = self.ascended(lone.argmax(axis=1))
        for start in range(2 * starts):
            sites = range(len(lone)) if start < starts else rng.integers(len(lone)) + np.arange(rng.integers(2, 5))
            row, among = best[0].copy(), int(rng.choice([5, 20, 60, 150])) if start < starts else 100
            for site in np.asarray(sites) % len(lone):
                row[site] = rng.choice(np.argpartition(-lone[site], among)[:among])
            best = max(best, self.ascended(row), key=lambda found: found[1])
        return best


def _targets(mapping: TileMapping, count: int, seed: int) -> list[FloatArray]:
    """Target phases of closed rows at random places, shape (2, n) each."""
    rng, lattice = np.random.default_rng(seed), mapping.aperture.lattice
    found: list[FloatArray] = []
    x_um, y_um = lattice.x_um(), lattice.y_um()
    while len(found) < count:
        row, column = rng.integers(np.array(lattice.shape) - [0, _SITES[1]]).tolist()
        if not mapping.aperture.inside(row, column, (1, _SITES[1])).all():
            continue
        target = mapping.profile(x_um[column : column + _SITES[1]], y_um[row : row + 1])[:, 0]
        turn = np.angle(np.exp(1j * np.diff(target))).mean(axis=1) / (2.0 * np.pi)
        sites = min(range(*_SITES), key=lambda n: float(np.abs(n * turn - np.rint(n * turn)).max()) + 0.01 * n)
        turns = np.rint(sites * turn)
        if np.abs(sites * turn - turns).max() < _FROM_WHOLE and turns.all():
            first = target[:, :1] + np.reshape(mapping.offset_rad, (2, 1))
            found.append(first + 2.0 * np.pi * turns[:, None] / sites * np.arange(sites))
    return found


def full_wave(cell: PillarCell, size_nm: FloatArray, target: FloatArray, resolution: float) -> ComplexArray:
    """Amplitudes of the wanted orders of a closed row by spectral elements, over their target waves, shape (2,).

    ``size_nm`` has the shape (n, 2); ``target``, shape (2, n), changes by whole turns over the row.
    """
    row = Supercell(cell, size_nm[None])
    t = orders_at(row, POLARISATIONS, resolution)
    return over_target(row, np.stack([t[:, axis, axis] for axis in range(2)]), target)


def by_meep(known: Library, size_nm: FloatArray, target: FloatArray, pixels_per_period: int) -> ComplexArray:
    """As :func:`full_wave`, by the coupling that Meep finds on a grid, added to the field of the library's pillars."""
    row, settings = Supercell(site_cell(known), size_nm[None]), SupercellSettings(pixels_per_period)
    solved = [solve_supercell(row, light, settings) for light in POLARISATIONS]
    lone = lone_orders(row, known).t
    fields = [lone[:, axis, axis] + one.co_polarised - one.local_period for axis, one in enumerate(solved)]
    return over_target(row, np.stack(fields), target)


def over_target(row: Supercell, t: ComplexArray, target: FloatArray) -> ComplexArray:
    """Amplitudes of the wanted orders among ``t``, shape (2, n_orders), over their target waves, shape (2,).

    ``target`` has the shape (2, n_x) of a row, or (2, n_y, n_x) of a block.
    """
    order, found = row.propagating_orders("x"), np.empty(2, dtype=np.complex128)
    for axis, wave in enumerate(target):
        wanted = row.local_period(order, np.exp(1j * np.atleast_2d(wave)))
        at = int(np.argmax(np.abs(wanted)))
        found[axis] = t[axis, at] / wanted[at]
    return found


def rows(
    design: Path,
    count: int,
    starts: int,
    limit_rad: float,
    seed: int,
    resolution: float | None = None,
    meep_pixels: Sequence[int] = (),
) -> Iterator[dict[str, float]]:
    """Light of each row: promised by lone pillars, of their sizes among neighbours, by one search, and by all.

    ``resolution``: spectral elements that also solve the lone sizes and the best ones; None leaves this out.
    ``meep_pixels``: grids on which Meep solves them, pixels a period.
    """
    spec = load_design(design)
    known: Library = library.load(Path(spec.library).with_suffix(".h5"))
    mapping = mapping_of(phase.profile_of(spec), known, spec)
    size_nm = np.asarray(mapping.table.size_dbu[1:] * mapping.table.database_unit_nm, dtype=np.float64)
    t = mapping.table.t[1:]
    models = [require_neighbours(known).line(0, light).model for light in POLARISATIONS]
    lights = _Light.of(models[0], size_nm, t[:, 0]), _Light.of(models[1], size_nm, t[:, 1])
    for target in _targets(mapping, count, seed):
        row = _Row(lights, np.exp(-1j * target), limit_rad, float(np.mean(power_ratio_of(known))))
        lone = row.lone.argmax(axis=1)
        promised = np.mean(row.weight * t[lone].T, axis=1)
        kept = (lone, row.ascended(lone)[0], row.searched(starts, seed)[0])
        sums = [np.array([each.sum for each in row.solve(sizes)]) / lone.size for sizes in kept]
        light = [float(row.light(mean)) for mean in (promised, *sums)]
        figures = dict(zip(("promised", "lone sizes", "one search", "all"), light, strict=True))
        judged = (("lone sizes", size_nm[lone]), ("all", size_nm[kept[-1]]))
        if resolution is not None:
            means = {name: full_wave(site_cell(known), sizes_nm, target, resolution) for name, sizes_nm in judged}
            figures |= {f"full wave, {name}": float(row.light(mean)) for name, mean in means.items()}
            figures["full wave, largest phase / rad"] = float(np.abs(np.angle(means["all"])).max())
        for pixels in meep_pixels:
            for name, sizes_nm in judged:
                figures[f"Meep {pixels}, {name}"] = float(row.light(by_meep(known, sizes_nm, target, pixels)))
        yield figures | {"sites": lone.size}


def _line(figures: dict[str, float]) -> str:
    return " ".join(f"{name} {value:.4g}" for name, value in figures.items())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("design", type=Path)
    parser.add_argument("--rows", type=int, default=6)
    parser.add_argument("--starts", type=int, default=16)
    parser.add_argument("--limit-rad", type=float, default=0.03)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--resolution", type=float, help="also solve rows by spectral elements of this resolution")
    parser.add_argument("--meep", type=int, nargs="+", default=[], metavar="PIXELS", help="also solve rows by Meep")
    asked = parser.parse_args()
    found = []
    for each in rows(asked.design, asked.rows, asked.starts, asked.limit_rad, asked.seed, asked.resolution, asked.meep):
        found.append(each)
        print(_line(each), flush=True)
    print("mean:", _line({name: float(np.mean([row[name] for row in found])) for name in found[0]}))
