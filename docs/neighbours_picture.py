"""Field behind one row of the paper's lens: Meep, spectral elements, chains of coupled modes, lone pillars.

``python docs/neighbours_picture.py LIBRARY.h5``, with a library that holds a model of neighbours, writes
``docs/theory/neighbours.png``. Spectral elements take about 10 s of processor time, Meep some 10 minutes.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.patches import Rectangle

from metafab import library
from metafab.cell import pillar_cell
from metafab.cell.elements import orders_at
from metafab.cell.meep import SupercellSettings
from metafab.cell.meep import solve_supercell as solve_by_meep
from metafab.cell.supercell import Supercell
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.library.neighbours import solve_supercell

INK, PILLAR, LONE, MEEP = "#20242c", "#2c7f62", "#c8963e", "#8d5fd3"
#: Pixels of Meep in a period.
PIXELS = 32
#: (width, length) in nm of a row of one local period of the 2 mm lens, at x = 429 um, y = 684 um; x polarised light.
ROW_NM = np.array(
    [
        (100.0, 188.0),
        (206.0, 142.0),
        (182.0, 168.0),
        (174.0, 174.0),
        (166.0, 182.0),
        (140.0, 204.0),
        (134.0, 218.0),
        (128.0, 232.0),
        (168.0, 100.0),
        (154.0, 112.0),
        (144.0, 122.0),
        (134.0, 130.0),
        (124.0, 140.0),
        (112.0, 150.0),
    ]
)


def main() -> None:
    """Solve the row and draw it."""
    known = library.load(Path(sys.argv[1]))
    row = Supercell(pillar_cell(known.unit_cell, 0.0, 0.0), ROW_NM[None])
    orders = row.propagating_orders("x")
    lone = row.local_period(orders, known.surface(*ROW_NM.T).t_xx[None])
    solved = {
        "lone pillars": (LONE, "--", lone),
        f"Meep, {PIXELS} pixels a period": (MEEP, "-.", lone + coupling_by_meep(row)),
        "chain of coupled modes": (PILLAR, "-", solve_supercell(known, row).t[:, 0, 0]),
        "spectral elements": (INK, ":", orders_at(row, ("x",), 3.0)[:, 0, 0]),
    }
    plt.rcParams.update({"font.size": 8, "text.color": INK, "axes.edgecolor": "#d3d8e0"})
    figure, axes = plt.subplots(3, 1, figsize=(7, 4.2), sharex=True, height_ratios=(1, 2.2, 2.2), layout="constrained")
    period_um = 1e-3 * known.unit_cell.cell.period_nm[0]
    span_um = period_um * len(ROW_NM)
    x_um = np.linspace(-span_um / 2, span_um / 2, 600)
    pillars(axes[0], (np.arange(len(ROW_NM)) + 0.5) * period_um - span_um / 2)
    for name, (colour, style, amplitudes) in solved.items():
        field = behind(x_um / span_um, orders[:, 0], amplitudes)
        axes[1].plot(x_um, np.abs(field), style, color=colour, label=name)
        # The wanted order, -1, turns by one period along the row.
        axes[2].plot(x_um, np.angle(field * np.exp(2j * np.pi * x_um / span_um)), style, color=colour)
    axes[1].set(ylabel="amplitude", xlim=(x_um[0], x_um[-1]), ylim=(0, None))
    axes[2].set(ylabel="phase to a plane wave / rad", xlabel="x / µm")
    axes[1].legend(loc="lower center", ncols=4, frameon=False)
    figure.savefig(Path(__file__).parent / "theory" / "neighbours.png", dpi=130, facecolor="white")


def coupling_by_meep(row: Supercell) -> ComplexArray:
    """Orders of the row less those of its lone pillars, x polarised light, all by Meep on one grid; shape (n_orders,).

    The error of the grid is common to both, and most of it cancels.
    """
    found = solve_by_meep(row, "x", SupercellSettings(PIXELS))
    return np.asarray(found.co_polarised - found.local_period)


def pillars(axes: plt.Axes, centre_um: FloatArray) -> None:
    """Pillars of the row from above."""
    for centre, (width, length) in zip(centre_um, 1e-3 * ROW_NM, strict=True):
        axes.add_patch(Rectangle((centre - width / 2, -length / 2), width, length, color=PILLAR, linewidth=0))
    axes.set(ylim=(-0.175, 0.175), aspect="equal", yticks=[])


def behind(place: FloatArray, order: FloatArray, amplitudes: ComplexArray) -> ComplexArray:
    """Propagating field behind the row at x over its length, shape (n,): the sum of its orders."""
    return np.asarray(np.exp(2j * np.pi * np.outer(place, order)) @ amplitudes)


if __name__ == "__main__":
    main()
