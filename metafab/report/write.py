"""Write the figures and the self-contained page of a run folder."""

from __future__ import annotations

from html import escape
from json import dumps
from pathlib import Path
from string import Template
from typing import Any

from metafab import __version__
from metafab.core.errors import InputError
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.files import plain, whole_file
from metafab.report.assets import asset
from metafab.report.draw import draw
from metafab.report.run_folder import RunFolder, open_run
from metafab.report.sections import device, images, light, overview
from metafab.report.viewers import decoded_view, psf_view


def write(run_dir: Path, progress: Progress = silent, workers: int | None = None) -> Path:
    """Write ``figures/*.png`` and ``report.html`` of a run folder (else InputError), from its files; return the page.

    A section whose files are missing holds a note.
    """
    if not (run_dir / "design.toml").is_file() and not (run_dir / "summary.json").is_file():
        got = "a folder without design.toml and summary.json" if run_dir.is_dir() else "no folder at that path"
        raise InputError.single(str(run_dir), "folder", "a run folder", got, "make one with `metafab run DESIGN.toml`")
    run = open_run(run_dir)
    drawn = draw(run, progress, workers)
    page = run_dir / "report.html"
    with whole_file(page) as part:
        part.write_text(compose(run, drawn), encoding="utf-8")
    return page


def compose(run: RunFolder, drawn: dict[str, str]) -> str:
    """The page as text, with style, script and data inside."""
    body = [
        overview.accounts(run, drawn),
        light.point_spread(run, drawn),
        light.tolerances(run),
        images.imaging(run, drawn),
        images.comparison(run, drawn),
        device.phases(run, drawn),
        device.mask(run, drawn),
        device.exposure(run, drawn),
        device.fullwave(run, drawn),
        device.library(run, drawn),
        overview.skipped(run),
        overview.provenance(run),
    ]
    views: dict[str, Any] = {}
    if run.psf is not None:
        views["psf"] = psf_view(run.psf, run.ideal_psf, run.psf_source, has_lobe=run.has_lobe)
    if run.decoded is not None:
        views["image"] = decoded_view(run.decoded)
    return Template(asset("page.html")).substitute(
        name=escape(run.name),
        subtitle=overview.subtitle(run),
        headlines=overview.headlines(run),
        sections="\n".join(body),
        style=asset("style.css"),
        script=asset("page.js"),
        # "<" is escaped, so that no text of a design can end the script element.
        data=dumps(plain(views), separators=(",", ":")).replace("<", "\\u003c"),
        version=__version__,
    )
