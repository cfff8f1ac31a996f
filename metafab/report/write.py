"""A run folder -> its pictures and one self-contained page."""

from __future__ import annotations

from html import escape
from importlib.resources import files
from json import dumps
from pathlib import Path
from string import Template
from typing import Any

from metafab import __version__
from metafab.core.errors import InputError
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.files import plain, whole_file
from metafab.report import sections
from metafab.report.draw import draw
from metafab.report.run_folder import RunFolder, open_run
from metafab.report.viewers import decoded_view, psf_view


def write(run_dir: Path, progress: Progress = silent, workers: int | None = None) -> Path:
    """Make ``figures/*.png`` and ``report.html`` of a run folder, from nothing but its files.

    A file or a figure of the summary that is missing leaves its section out, with a note.

    Args:
        run_dir: the run folder.
        progress: called as figures are drawn.
        workers: processes that draw; None for all cores. The files are the same.

    Returns:
        Path of the page.

    Raises:
        InputError: ``run_dir`` is no run folder.
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
    """The page as text: template, style, script and data in one."""
    body = [
        sections.accounts(run, drawn),
        sections.point_spread(run, drawn),
        sections.tolerances(run),
        sections.imaging(run, drawn),
        sections.comparison(run, drawn),
        sections.phases(run, drawn),
        sections.mask(run, drawn),
        sections.fullwave(run, drawn),
        sections.library(run, drawn),
        sections.cost(run, drawn),
        sections.provenance(run),
    ]
    views: dict[str, Any] = {}
    if run.psf is not None:
        views["psf"] = psf_view(run.psf, run.ideal_psf, run.psf_source)
    if run.decoded is not None:
        views["image"] = decoded_view(run.decoded)
    return Template(_asset("page.html")).substitute(
        name=escape(run.name),
        subtitle=sections.subtitle(run),
        headlines=sections.headlines(run),
        sections="\n".join(body),
        style=_asset("style.css"),
        script=_asset("page.js"),
        # "<" is escaped so that no text of a design can end the script element.
        data=dumps(plain(views), separators=(",", ":")).replace("<", "\\u003c"),
        version=__version__,
    )


def _asset(name: str) -> str:
    return (files("metafab.report") / name).read_text(encoding="utf-8")
