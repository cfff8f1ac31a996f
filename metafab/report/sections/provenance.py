"""Skipped work, versions and files of a run."""

from __future__ import annotations

from html import escape

from metafab.report import html
from metafab.report.run_folder import RunFolder
from metafab.steps.summary import SUMMARY_FILE, UNCHANGED, Saving

#: Files that grow or change after the page is written: their sizes would make two pages of one run differ.
_LATER = {"report.html", "steps.json", SUMMARY_FILE}


def skipped(run: RunFolder) -> str:
    """Steps that the design does not need, and work that the others left out.

    Times and memory stand in ``summary.json`` alone, so that equal runs give equal pages.
    """
    steps = [[escape(entry.step), html.prose(entry.why)] for entry in run.summary.skipped if entry.why != UNCHANGED]
    savings = [_saving(entry) for entry in run.summary.saved]
    unneeded = html.note("the design needs every step")
    if steps:
        unneeded = html.table(["skipped step", "reason"], steps, kind="stack")
    head = ["step", "pieces of work", "computed", "of", "safe because", "error"]
    return html.section(
        "skipped",
        "Skipped work",
        unneeded,
        html.table(head, savings, ["", "", "n", "n", "", ""]) if savings else "",
    )


def _saving(entry: Saving) -> list[str]:
    """Row of a saving."""
    of = "any" if entry.of is None else html.number(entry.of)
    error = "none" if entry.error_of is None else "not measured"
    if entry.error is not None and entry.error_of is not None:
        error = f"{html.number(entry.error, 2)} ({escape(entry.error_of)})"
    return [entry.step, entry.what, html.number(entry.computed), of, html.prose(entry.why), error]


def provenance(run: RunFolder) -> str:
    """Versions, files and design of the run."""
    versions = "\u2002".join(f"{escape(name)}\u00a0{escape(version)}" for name, version in run.summary.versions.items())
    files = sorted(p for p in run.path.iterdir() if p.is_file() and not p.name.startswith("."))
    rows = [
        [f'<a href="{escape(p.name)}">{escape(p.name)}</a>', html.number(p.stat().st_size)]
        for p in files
        if p.name not in _LATER
    ]
    design = ""
    if (run.path / "design.toml") in files:
        text = (run.path / "design.toml").read_text(encoding="utf-8")
        design = f"<details><summary>design.toml</summary><pre>{escape(text)}</pre></details>"
    return html.section(
        "provenance",
        "Provenance",
        html.paragraph(versions) if versions else html.note("summary.json holds no versions"),
        html.table(["file of this run", "bytes"], rows, ["", "n"]) if rows else "",
        design,
    )
