"""Seconds, memory, what was skipped, and which code and inputs made it all."""

from __future__ import annotations

from html import escape

from metafab.report import html
from metafab.report.run_folder import RunFolder
from metafab.report.sections.parts import Drawn


def cost(run: RunFolder, drawn: Drawn) -> str:
    """Seconds, memory, and what was not done."""
    seconds, memory = run.part("seconds"), run.part("peak_rss_mb")
    rows = [
        [escape(step), html.number(float(value)), html.number(memory.get(step))]
        for step, value in seconds.items()
        if isinstance(value, int | float)
    ]
    skipped = [line for line in run.summary.get("skipped") or [] if isinstance(line, dict)]
    return html.section(
        "cost",
        "Time, memory, and what was skipped",
        html.grid([html.figure(drawn["seconds"]), html.table(["step", "seconds", "peak MB"], rows, ["", "n", "n"])])
        if "seconds" in drawn
        else html.note("summary.json holds no timings"),
        html.table(
            ["skipped", "why that was safe"],
            [[escape(str(line.get("step", ""))), html.prose(line.get("why", ""))] for line in skipped],
            kind="stack",
        )
        if skipped
        else html.note("nothing was skipped: every step ran"),
    )


def provenance(run: RunFolder) -> str:
    """Which code and which inputs made this."""
    versions = "\u2002".join(
        f"{escape(name)}\u00a0{escape(str(version))}" for name, version in run.part("versions").items()
    )
    files = sorted(p for p in run.path.iterdir() if p.is_file() and not p.name.startswith("."))
    rows = [
        [f'<a href="{escape(p.name)}">{escape(p.name)}</a>', html.number(p.stat().st_size)]
        for p in files
        if p.name != "report.html"
    ]
    design = ""
    if "design_table" not in run.notes:
        text = (run.path / "design.toml").read_text(encoding="utf-8")
        design = f"<details><summary>design.toml</summary><pre>{escape(text)}</pre></details>"
    return html.section(
        "provenance",
        "Provenance",
        html.paragraph(versions) if versions else html.note("summary.json holds no versions"),
        html.table(["file of this run", "bytes"], rows, ["", "n"]) if rows else "",
        design,
    )
