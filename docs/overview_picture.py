"""The picture of the README, from a finished run of the paper's lens.

``metafab run layouts/helix_2mm.toml`` and then ``python docs/overview_picture.py`` write ``docs/overview.png``.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import h5py
import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.patches import Rectangle

from metafab import mask
from metafab.spec import load_design

ROOT = Path(__file__).parents[1]
INK, PILLAR = "#20242c", "#2c7f62"
#: Place and half side of the pillars shown (um).
PLACE_UM, HALF_UM = (420.0, 230.0), 2.6
#: Number of depths shown.
DEPTHS = 4


def main() -> None:
    """Draw the picture of a run folder."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", nargs="?", type=Path, default=ROOT / "runs" / "helix_2mm")
    parser.add_argument("--design", type=Path, default=ROOT / "layouts" / "helix_2mm.toml")
    arguments = parser.parse_args()
    plt.rcParams.update({"font.size": 8, "text.color": INK, "axes.edgecolor": "#d3d8e0"})
    figure = plt.figure(figsize=(11, 3.0), layout="constrained")
    left, middle, right = figure.subfigures(1, 3, width_ratios=(1.15, 1.55, 2.2))
    pillars(left.subplots(), arguments.run, arguments.design)
    pairs(middle.subplots(2, DEPTHS, gridspec_kw={"hspace": 0.0, "wspace": 0.03}), arguments.run)
    images(right, arguments.run)
    figure.savefig(ROOT / "docs" / "overview.png", dpi=150, facecolor="white")


def pillars(axes: plt.Axes, run: Path, design: Path) -> None:
    """Written pillars at one place, read from the OASIS file."""
    written = mask.read(run / "layout.oas", load_design(design)).pillars
    lattice, index, size_um = written.lattice, written.to_array(), written.size_nm() * 1e-3
    x_um, y_um = lattice.x_um() - PLACE_UM[0], lattice.y_um() - PLACE_UM[1]
    for row in np.flatnonzero(np.abs(y_um) < HALF_UM):
        for column in np.flatnonzero(np.abs(x_um) < HALF_UM):
            width, length = size_um[index[row, column]]
            corner = (x_um[column] - width / 2, y_um[row] - length / 2)
            axes.add_patch(Rectangle(corner, width, length, color=PILLAR, linewidth=0))
    axes.set(xlim=(-HALF_UM, HALF_UM), ylim=(-HALF_UM, HALF_UM), aspect="equal", xticks=[], yticks=[])
    axes.add_patch(Rectangle((-2.55, -2.55), 1.35, 0.75, color="white", alpha=0.9))
    axes.plot([-2.4, -1.4], [-2.4, -2.4], color=INK, linewidth=2)
    axes.text(-1.9, -2.3, "1 µm", ha="center", va="bottom")
    axes.set_title("written pillars (of 25.6 million)", fontsize=8)


def pairs(axes: np.ndarray, run: Path) -> None:
    """PSFs of both polarisations over depth."""
    with h5py.File(run / "psf.h5") as file:
        depth_m, psf = file["depth_m"][:], file["psf"][:]
    shown = np.linspace(1, depth_m.size - 2, DEPTHS).astype(int)
    middle = slice(psf.shape[-1] // 2 - 14, psf.shape[-1] // 2 + 15)
    for row, name in enumerate("xy"):
        for column, k in enumerate(shown):
            place = axes[row, column]
            place.imshow(psf[row, k, middle, middle], origin="lower", cmap="inferno", interpolation="bicubic")
            place.set(xticks=[], yticks=[])
            if row == 0:
                place.set_title(f"{100 * depth_m[k]:.0f} cm", fontsize=8)
        axes[row, 0].set_ylabel(f"{name} polarised")


def images(figure: plt.Figure, run: Path) -> None:
    """Raw frame above, decoded image and depth map below."""
    with h5py.File(run / "raw.h5") as file:
        frame = file["frame"][:]
    with h5py.File(run / "decoded.h5") as file:
        intensity, depth_m = file["intensity_x"][:], file["depth_m"][:]
    places = figure.subplot_mosaic([["raw", "raw"], ["image", "depth"]])
    places["raw"].imshow(frame, origin="lower", cmap="gray", vmin=0, vmax=np.percentile(frame, 99.8))
    places["raw"].set_title("one raw frame", fontsize=8)
    places["image"].imshow(intensity, origin="lower", cmap="gray", vmin=0, vmax=np.percentile(intensity, 99.8))
    places["image"].set_title("decoded image", fontsize=8)
    shown = places["depth"].imshow(100 * depth_m, origin="lower", cmap="viridis")
    places["depth"].set_title("depth / cm", fontsize=8)
    figure.colorbar(shown, ax=places["depth"], shrink=0.8)
    for place in places.values():
        place.set(xticks=[], yticks=[])


if __name__ == "__main__":
    main()
