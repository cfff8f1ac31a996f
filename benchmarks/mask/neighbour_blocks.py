"""Light that a mapping among neighbours wins in blocks of which neither rows nor columns are alike.

    python -m benchmarks.mask.neighbour_blocks DESIGN.toml [--blocks 4] [--sides 6 7] [--passes 3] [--seed 1]

Each block is a period of a grating that deflects x and y polarised light by one turn of phase over its width, in
opposite senses, and by one turn over its height. A mask of such blocks is mapped with the library's model of
neighbours, which adds the corrections by rows and by columns. The light of the block in the middle is stated by this
model (``lines``), and with the joint effect of rows and columns solved (``joint``, blocks of up to 49 pillars;
:mod:`metafab.library.neighbours.blocks.joint`): two minutes of processor time for 7 x 7 pillars, and 4 GB. The library
lies beside the design's unit cell.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks.mask.neighbour_rows import over_target
from metafab import library, phase
from metafab.cell.supercell import Supercell
from metafab.core.conventions import FloatArray
from metafab.fullwave.written import site_cell
from metafab.layout.assign import mapping_of
from metafab.library.neighbours import require_neighbours, solve_supercell
from metafab.library.neighbours.mask.choice import ROUNDS, NeighbourChoice
from metafab.library.use.amplitudes import power_ratio_of
from metafab.spec import load_design

#: Least side of the mapped mask, sites; its ends have no neighbours.
_MASK_SITES = 96


def targets(count: int, sides: Sequence[int], seed: int) -> Iterator[FloatArray]:
    """Target phases of x and y polarised light over blocks, shape (2, n_y, n_x) each."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        n_y, n_x = rng.choice(sides, 2)
        down, first = np.array([1, rng.choice([1, -1])]), rng.uniform(0.0, 2.0 * np.pi, 2)
        row, column = np.arange(n_y)[:, None] / n_y, np.arange(n_x) / n_x
        turns = down[:, None, None] * row + np.array([1, -1])[:, None, None] * column
        yield first[:, None, None] + 2.0 * np.pi * turns


def blocks(design: Path, count: int, sides: Sequence[int], passes: int, seed: int) -> Iterator[dict[str, float]]:
    """Light of each block: promised by lone pillars, of their sizes, and of those after each pass of the mapping."""
    spec = load_design(design)
    known = library.load(Path(spec.library).with_suffix(".h5"))
    table = mapping_of(phase.profile_of(spec), known, spec).table
    size_nm = np.asarray(table.size_dbu * table.database_unit_nm, dtype=np.float64)
    choice = NeighbourChoice.of(require_neighbours(known), size_nm, table.t)
    ratio = float(np.mean(power_ratio_of(known)))
    for target in targets(count, sides, seed):
        n_y, n_x = target.shape[1:]
        down, right = -(-_MASK_SITES // n_y), -(-_MASK_SITES // n_x)
        mask = np.tile(target, (1, down, right))
        first_row, first_column = down // 2 * n_y, right // 2 * n_x
        core = slice(first_row, first_row + n_y), slice(first_column, first_column + n_x)
        lone = table.sizes_for(mask[0], mask[1])
        found, sizes = {"lone sizes": lone}, lone.copy()
        for number in range(1, passes + 1):
            choice.improve(sizes, mask)
            found[f"{number * ROUNDS} rounds"] = sizes.copy()
        t = np.moveaxis(table.t[lone[core]], -1, 0)
        promised = np.mean(np.exp(-1j * target) * t, axis=(1, 2))
        figures = {"rows": n_y, "columns": n_x, "promised": float((np.abs(promised) ** 2).mean() * ratio)}
        for name, chosen in found.items():
            lines = choice.reached(chosen, mask)[:, *core].mean(axis=(1, 2))
            block = Supercell(site_cell(known), size_nm[chosen[core]])
            solved = solve_supercell(known, block).t
            joint = over_target(block, np.stack([solved[:, axis, axis] for axis in range(2)]), target)
            for kind, mean in (("lines", lines), ("joint", joint)):
                figures[f"{name}, {kind}"] = float((np.abs(mean) ** 2).mean() * ratio)
        yield figures


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("design", type=Path)
    parser.add_argument("--blocks", type=int, default=4)
    parser.add_argument("--sides", type=int, nargs="+", default=[6, 7], metavar="N", help="sides, pillars")
    parser.add_argument("--passes", type=int, default=1, metavar="N", help="passes of the mapping's rounds")
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    for each in blocks(asked.design, asked.blocks, asked.sides, asked.passes, asked.seed):
        print(" ".join(f"{name} {value:.4g}" for name, value in each.items()), flush=True)
