"""Coupling of the chains across the lines: small blocks of pillars, solved by spectral elements, and a fit to them.

The target phases of both polarisations change steadily over a block, as in a lens, each in a direction of its own. Most
blocks are their own image under a half turn, and cost a fifth of others. Blocks of 3 x 3 see the modes at the Bloch
phases of thirds of a turn across the lines; fitted to these alone, blocks of 4 x 4 became worse. Six blocks of 5 x 5
beside 64 smaller ones lowered the error of others from 0.076 to 0.059, and that of 4 x 4 from 0.042 to 0.036.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from metafab.cell import PillarCell, pillar_cell
from metafab.cell.elements.solve import orders_at
from metafab.cell.supercell import Supercell
from metafab.core.conventions import POLARISATIONS, ComplexArray, FloatArray
from metafab.core.parallel.executor import SerialExecutor
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.files import fingerprint
from metafab.core.storage.provenance import sources_sha256
from metafab.library.library import Library
from metafab.library.neighbours.blocks.cross import CrossLight, free_elements
from metafab.library.neighbours.blocks.lattice import BlockLight, SolvedLines
from metafab.library.neighbours.model import Neighbours, TrainedLine
from metafab.library.neighbours.rows import BEST, RESOLUTION, STEEPEST_RAD, solve_sampled
from metafab.library.sweep.checkpoint import Checkpoint

#: Pillars along y and x of the blocks, in turn, and whether a half turn maps them to themselves.
BLOCK_KINDS = (((3, 3), True), ((4, 4), True), ((3, 3), False), ((5, 5), True))
#: Weight of the squared free elements of K, relative to one block whose error is :data:`_FLOOR`.
_RIDGE = 1e-2
#: Relative error of a block without K above which it counts less: strong resonances would rule the fit.
_FLOOR = 0.03
#: The same for cross-polarised light: weight of the squared free elements of all M, and the relative error of a light
#: without them above which it counts less. Of 128 lights of 64 blocks 0.087 are cross-polarised (rms); in those not
#: fitted 0.054 to 0.058 are left with weights of 0.3 to 3, on windows of a lens 0.010 of 0.017.
_CROSS_RIDGE, _CROSS_FLOOR = 1.0, 0.01
#: Steps of the fit. With more, unseen blocks of a lens become worse.
_STEPS = 12
#: Damping at which no step lessens the residuals.
_MOST_DAMPING = 1e8


@dataclass(frozen=True)
class BlockSampler:
    """Chooses blocks by number, and solves them."""

    cell: PillarCell  #: Period and materials; its size is ignored.
    size_nm: FloatArray  #: Shape (n, 2), the library's sizes, (width, length).
    t: ComplexArray  #: Shape (n, 2), the library's t of x and y polarised light.

    @classmethod
    def of(cls, library: Library) -> BlockSampler:
        """Blocks of a library's pillars."""
        width, length = np.meshgrid(library.width_nm, library.length_nm)
        size_nm = np.stack([width, length], axis=-1).reshape(-1, 2)
        return cls(pillar_cell(library.unit_cell, 0.0, 0.0), size_nm, library.t.reshape(-1, 2))

    def supercell(self, number: int) -> Supercell:
        """The block of a number; it depends on the number alone."""
        shape, turned = BLOCK_KINDS[number % len(BLOCK_KINDS)]
        rng = np.random.default_rng([len(BLOCK_KINDS), number])
        sites = math.prod(shape)
        drawn = (sites + 1) // 2 if turned else sites
        start, towards = rng.uniform(0.0, 2.0 * np.pi, (2, 2))
        slope = STEEPEST_RAD * np.sqrt(rng.random(2)) * np.stack([np.sin(towards), np.cos(towards)])
        target = np.exp(-1j * (start + np.indices(shape).reshape(2, -1).T[:drawn] @ slope))
        overlap = np.einsum("sp,np->sn", target, self.t, optimize=True).real
        best = np.argpartition(-overlap, BEST, axis=1)[:, :BEST]
        size_nm = self.size_nm[best[np.arange(drawn), rng.integers(0, BEST, drawn)]]
        images = size_nm[: sites - drawn][::-1]
        return Supercell(self.cell, np.concatenate([size_nm, images]).reshape(*shape, 2))

    def solve(self, number: int, resolution: float) -> tuple[complex, ...]:
        """Amplitudes of all orders of block ``number``, indexed [order, out, in], at one resolution."""
        return tuple(orders_at(self.supercell(number), POLARISATIONS, resolution).ravel().tolist())


def inputs_of_blocks(library: Library) -> str:
    """Fingerprint of a training's blocks: pillars, sizes to draw from, resolution, and the code that solves them."""
    sampler = BlockSampler.of(library)
    drawn = hashlib.sha256(sampler.size_nm.tobytes() + sampler.t.tobytes()).hexdigest()
    code = sources_sha256(("metafab.library.neighbours.rows",), ())
    return fingerprint(sampler.cell, drawn, BLOCK_KINDS, RESOLUTION, code)


def couple(
    library: Library,
    neighbours: Neighbours,
    count: int,
    record: Checkpoint,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> Neighbours:
    """Solve ``count`` blocks, and fit the couplings of all chains across lines and between polarisations to them.

    Args:
        library: library with the pillars of the chains.
        neighbours: its trained chains.
        count: number of blocks.
        record: checkpoint with the solved blocks.
        executor: solves the blocks; None for this process.
        progress: called with the number of solved blocks.
    """
    sampler = BlockSampler.of(library)
    step = "blocks of unlike pillars"
    (solved,) = solve_sampled([sampler], [range(count)], record, executor or SerialExecutor(), progress, step)
    blocks = [(sampler.supercell(number), np.reshape(each, (-1, 2, 2))) for number, each in sorted(solved.items())]
    lights = [light for block in blocks for light in _lights(library, neighbours, *block)]
    sizes = [line.model.shape.pairs[0].size for line in neighbours.lines]
    coupled = neighbours.with_couplings(np.split(_fit(lights, sum(sizes)), np.cumsum(sizes)[:-1]))
    return replace(coupled, cross=_cross_fit(coupled, blocks))


@dataclass(frozen=True)
class _Light:
    """Co-polarised orders of a block for one incident polarisation."""

    sums: tuple[tuple[slice, BlockLight], ...]  #: Chains along x and along y, each with its place in the vector.
    rest: ComplexArray  #: Shape (orders,), field of the pillars among equal ones, less the solved one.
    weight: float  #: Of the residual.

    def residual(self, vector: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Weighted residual, shape (orders,), and its derivatives by the vector, shape (orders, n)."""
        light, slopes = self.rest.copy(), np.zeros((self.rest.size, vector.size), dtype=np.complex128)
        for part, chains in self.sums:
            found, by_part = chains.orders(vector[part])
            light += found
            slopes[:, part] += by_part
        return self.weight * light, self.weight * slopes


def _lights(library: Library, neighbours: Neighbours, supercell: Supercell, t: ComplexArray) -> list[_Light]:
    """Light of a solved block in both polarisations; a resonant one counts less.

    ``t`` has the shape (orders, 2, 2), indexed [order, out, in].
    """
    size_nm, lines = supercell.size_nm, neighbours.lines
    ends = np.cumsum([0, *(line.model.shape.pairs[0].size for line in lines)])
    known = library.surface(size_nm[..., 0], size_nm[..., 1])
    to_orders = _to_orders(supercell)
    of_columns = to_orders.reshape(-1, *supercell.shape).swapaxes(1, 2).reshape(to_orders.shape)
    lights = []
    for axis, (name, local) in enumerate(zip(POLARISATIONS, (known.t_xx, known.t_yy), strict=True)):
        sums = []
        views = (size_nm, to_orders), (size_nm.transpose(1, 0, 2)[..., ::-1], of_columns)
        for direction, (along_nm, light) in enumerate(views):
            line = neighbours.line(direction, name)
            number = next(k for k, each in enumerate(lines) if each is line)
            chains = BlockLight.of(line.model, line.model.polynomials(along_nm), light)
            sums.append((slice(int(ends[number]), int(ends[number + 1])), chains))
        rest, norm = to_orders @ local.ravel() - t[:, axis, axis], float(np.linalg.norm(t[..., axis]))
        unweighted = _Light(tuple(sums), rest, 1.0 / norm)
        error = float(np.linalg.norm(unweighted.residual(np.zeros(ends[-1], dtype=np.complex128))[0]))
        lights.append(replace(unweighted, weight=_FLOOR / math.hypot(_FLOOR, error) / norm))
    return lights


def _fit(lights: Sequence[_Light], size: int) -> ComplexArray:
    """Free elements of K of all chains in turn, shape (size,), by the Levenberg-Marquardt method."""
    vector, damping = np.zeros(size, dtype=np.complex128), 0.1

    def stacked(vector: ComplexArray) -> tuple[ComplexArray, ComplexArray, float]:
        found = [each.residual(vector) for each in lights]
        residual, slopes = (np.concatenate([each[k] for each in found]) for k in (0, 1))
        return residual, slopes, float(np.linalg.norm(residual) ** 2 + _RIDGE * np.linalg.norm(vector) ** 2)

    residual, slopes, loss = stacked(vector)
    for _ in range(_STEPS):
        normal = slopes.conj().T @ slopes + _RIDGE * np.eye(size)
        gradient = slopes.conj().T @ residual + _RIDGE * vector
        while damping < _MOST_DAMPING:
            trial = vector - np.linalg.solve(normal + damping * np.diag(np.diag(normal)), gradient)
            there = stacked(trial)
            if there[-1] < loss:
                break
            damping *= 4.0
        else:
            break
        vector, damping = trial, damping / 5.0
        residual, slopes, loss = there
    return vector


def _to_orders(supercell: Supercell) -> ComplexArray:
    """Matrix from the field of the sites of a block to the amplitudes of its orders, shape (orders, sites)."""
    orders = supercell.propagating_orders("x")
    sites = np.eye(supercell.size_nm[..., 0].size, dtype=np.complex128).reshape(-1, *supercell.shape)
    return np.stack([supercell.local_period(orders, site) for site in sites], axis=1)


def _cross_fit(neighbours: Neighbours, blocks: Sequence[tuple[Supercell, ComplexArray]]) -> ComplexArray:
    """Free elements of the couplings of both polarisations, shape (n,): linear least squares."""
    size = free_elements(neighbours)
    normal, gradient = _CROSS_RIDGE * np.eye(size, dtype=np.complex128), np.zeros(size, dtype=np.complex128)
    for supercell, t in blocks:
        views = supercell.size_nm, supercell.size_nm.transpose(1, 0, 2)[..., ::-1]
        lines = [
            [_solved(neighbours.line(direction, light), view) for direction, view in enumerate(views)]
            for light in POLARISATIONS
        ]
        slopes = CrossLight(neighbours, lines).slopes(_to_orders(supercell))
        for axis, by_element in enumerate(slopes):
            norm, wanted = float(np.linalg.norm(t[:, :, axis])), t[:, 1 - axis, axis]
            weight = _CROSS_FLOOR / math.hypot(_CROSS_FLOOR, float(np.linalg.norm(wanted)) / norm) / norm
            normal += weight**2 * by_element.conj().T @ by_element
            gradient += weight**2 * by_element.conj().T @ wanted
    return np.asarray(np.linalg.solve(normal, gradient))


def _solved(line: TrainedLine, size_nm: FloatArray) -> SolvedLines:
    """Coupled lines of a block, sizes of shape (lines, sites, 2)."""
    if line.coupling is None:
        raise ValueError("the lines are not coupled")
    return SolvedLines.of(line.model, line.coupling, line.model.polynomials(size_nm))
