"""The ``device`` directive: makes a device of a kind as ``metafab new`` and ``metafab run`` do, and shows its pictures.

Made again only where the code or the kind has changed, by the same rules as any run.
"""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive

from metafab.report.draw import draw
from metafab.report.run_folder import open_run
from metafab.run import run
from metafab.spec import load_design, write_new
from metafab.steps import RESULT_STEPS

FOLDER = "_gallery"
#: Pictures of a run that tell one device from another: its mask from afar and close by, and its light.
PICTURES = {"mask": "The whole mask", "mask_close": "Single pillars", "psf_pair": "What the written file does to light"}

#: Steps whose results are not shown.
NOT_SHOWN = {"study", "orders", "capture", "decode"}


class Device(Directive):
    """``device`` with the kind as its argument."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Pictures in a row, and the figures of the run in a line."""
        kind = self.arguments[0]
        source = Path(self.state.document.settings.env.srcdir)
        summary = make(kind, source / FOLDER / kind)
        row = nodes.paragraph()
        for picture, text in PICTURES.items():
            uri = f"/{FOLDER}/{kind}/run/figures/{picture}.png"
            row += nodes.image(uri=uri, alt=f"{text}: {kind}", height="14em")
        return [row, nodes.paragraph(text=sentence(summary))]


def make(kind: str, folder: Path) -> dict[str, Any]:
    """Write today's design of the kind, run it up to its light, and return its summary."""
    folder.mkdir(parents=True, exist_ok=True)
    design = folder / f"{kind}.toml"
    with TemporaryDirectory(dir=folder.parent) as fresh:  # As deep as the folder: the paths of the design are relative.
        write_new(kind, kind, Path(fresh))
        for file in Path(fresh).iterdir():
            kept = folder / file.name
            if not kept.is_file() or kept.read_bytes() != file.read_bytes():
                file.replace(kept)
    steps = [step for step in RESULT_STEPS if step.name not in NOT_SHOWN]
    run(load_design(design), folder / "run", steps=steps)
    draw(open_run(folder / "run"), only=PICTURES)
    found: dict[str, Any] = json.loads((folder / "run" / "summary.json").read_text(encoding="utf-8"))
    return found


def sentence(summary: dict[str, Any]) -> str:
    """What the run measured."""
    merit, layout = summary["merit"], summary["layout"]
    broken = sum(summary["drc"]["violations"].values())
    share, pinhole_um = merit["pinhole_efficiency_x"][0], merit["pinhole_um"]
    return (
        f"{layout['pillars']:,} pillars of {layout['distinct_sizes']:,} sizes, {broken} rules broken; {share:.0%} of "
        f"the light at the aperture passes a pinhole of {pinhole_um:.0f} µm around the image point, and the peak is "
        f"{merit['relative_peak_x'][0]:.0%} of the perfect phase's."
    )


def setup(app: Any) -> dict[str, bool]:
    """Register the directive; devices share a library, so they are made one after another."""
    app.add_directive("device", Device)
    return {"parallel_read_safe": False}
