"""Time and memory of the steps, skipped steps, versions and files of a run."""

from __future__ import annotations

from html import escape

from metafab.report import html
from metafab.report.html import Drawn
from metafab.report.run_folder import RunFolder


def cost(run: RunFolder, drawn: Drawn) -> str:
    """Time and memory of each step, and the skipped steps."""
    summary = run.summary
    rows = [
        [escape(step), html.number(seconds), html.number(summary.peak_rss_mb.get(step))]
        for step, seconds in summary.seconds.items()
    ]
    skipped = [[escape(entry.step), html.prose(entry.why)] for entry in summary.skipped]
    return html.section(
        "cost",
        "Time, memory and skipped steps",
        html.grid([html.figure(drawn["seconds"]), html.table(["step", "seconds", "peak MB"], rows, ["", "n", "n"])])
        if "seconds" in drawn
        else html.note("summary.json holds no timings"),
        html.table(["skipped step", "reason"], skipped, kind="stack")
        if skipped
        else html.note("nothing was skipped: every step ran"),
    )


def provenance(run: RunFolder) -> str:
    """Versions, files and design of the run."""
    versions = "\u2002".join(f"{escape(name)}\u00a0{escape(version)}" for name, version in run.summary.versions.items())
    files = sorted(p for p in run.path.iterdir() if p.is_file() and not p.name.startswith("."))
    rows = [
        [f'<a href="{escape(p.name)}">{escape(p.name)}</a>', html.number(p.stat().st_size)]
        for p in files
        if p.name != "report.html"
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
