"""The picture of the test structures in ``docs/howto/send-to-the-ebeam.md``, from the tables of that page.

``python docs/kit_picture.py`` writes ``docs/howto/kit.png``.
"""

from __future__ import annotations

import re
import tempfile
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.patches import Circle, Patch

from metafab.mask import shapes_beside
from metafab.spec import Chip, Design, load_design

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "howto" / "send-to-the-ebeam.md"
#: Frame, label and bar that fit a lens of 0.2 mm.
CHIP = Chip(
    margin_um=130.0, mark_um=40.0, mark_line_um=2.0, frame_um=5.0, street_um=0.0,
    label="LOT 7", text_um=7.0, scale_bar_um=20.0,
)  # fmt: skip
#: Name in the legend and colour of each layer, in the order of drawing.
LAYERS = {
    "windows around marks": ("windows", "#e6e6e6"),
    "alignment marks": ("marks", "#6b4f1d"),
    "frame": ("frame", "#888888"),
    "label and scale bar": ("text", "#c9a75a"),
    "test structures of the first exposure": ("first exposure", "#b03030"),
    "test structures": ("with the pillars", "#217b3b"),
}
#: Title, x and y (um) of each part.
PARTS = (
    ("bars", (-175.0, -125.0), (27.0, 90.0)),
    ("vernier", (-190.0, -100.0), (-80.0, -20.0)),
    ("corner of the grating", (129.5, 132.5), (39.5, 42.5)),
)


def main() -> None:
    """Draw the whole chip, and parts of it."""
    design = design_of_page()
    plt.rcParams.update({"font.size": 7})
    figure, places = plt.subplots(1, 4, figsize=(11.2, 3.7), width_ratios=(1.8, 1.0, 1.1, 1.1), layout="constrained")
    half = 0.5 * design.device.aperture_um + CHIP.margin_um + 2.0 * CHIP.frame_um
    draw(places[0], design, (-half, half), (-half, half), line_pt=0.7)
    places[0].set_ylabel("y / um")
    colours = {"pillars": "#5b9bd5"} | dict(LAYERS.values())
    handles = [Patch(color=colour, label=name) for name, colour in colours.items()]
    places[0].legend(handles=handles, ncols=4, loc=(0.05, 0.88), frameon=False, fontsize=5.5, columnspacing=1.2)
    for place, (title, x_um, y_um) in zip(places[1:], PARTS, strict=True):
        draw(place, design, x_um, y_um)
        place.set_title(title, fontsize=7)
    figure.savefig(PAGE.parent / "kit.png", dpi=150, facecolor="white")


def design_of_page() -> Design:
    """The small lens with the test structures of the page."""
    (kit,) = re.findall(r"```toml\n(\[mask\.kit\]\n.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    small = ROOT / "layouts" / "helix_small.toml"
    text = small.read_text(encoding="utf-8").replace("../unitcell_lib", str(ROOT / "unitcell_lib"))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "kit.toml")
        path.write_text(f"{text}\n{kit}", encoding="utf-8")
        design = load_design(path)
    return replace(design, mask=replace(design.mask, chip=CHIP))


def draw(
    place: plt.Axes, design: Design, x_um: tuple[float, float], y_um: tuple[float, float], line_pt: float = 0.0
) -> None:
    """Draw all shapes within a box, with a line around those too narrow to see; the lens as its aperture."""
    place.add_patch(Circle((0.0, 0.0), 0.5 * design.device.aperture_um, color="#5b9bd5", linewidth=0))
    drawn = {layer.name: layer.rectangles for layer in shapes_beside(design)[0]}
    for name, (_, colour) in LAYERS.items():
        x, y, width, height = drawn[name].T * design.mask.database_unit_nm * 1e-3
        seen = (x < x_um[1]) & (x + width > x_um[0]) & (y < y_um[1]) & (y + height > y_um[0])
        corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
        outlines = np.stack([np.stack(corner, axis=1) for corner in corners], axis=1)[seen]
        place.add_collection(PolyCollection(outlines, color=colour, linewidth=line_pt))
    place.set(xlim=x_um, ylim=y_um, aspect="equal", xlabel="x / um")


if __name__ == "__main__":
    main()
