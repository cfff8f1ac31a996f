"""Where the light goes, and where the error comes from."""

from __future__ import annotations

from html import escape

from metafab.report import html
from metafab.report.accounts import chain_of
from metafab.report.run_folder import RunFolder
from metafab.report.sections.parts import Drawn


def accounts(run: RunFolder, drawn: Drawn) -> str:
    """Loss chain and error budget."""
    budget = run.summary.get("error_budget") or []
    chain = chain_of(run)
    rows = [
        [
            escape(str(line.get("source", ""))),
            html.number(line["value"]) if line.get("value") is not None else "not measured",
            escape(str(line.get("unit", ""))),
            html.prose(line.get("how", "")),
        ]
        for line in budget
    ]
    return html.section(
        "accounts",
        "Where the light goes, and where the error comes from",
        html.grid(
            html.figure(drawn[name]) for name in drawn if name == "loss_chain" or name.startswith("error_budget")
        ),
        "" if chain else html.note(run.notes.get("psf", "the run holds no efficiencies: no loss chain")),
        html.table(["source", "error", "unit", "how it was measured"], rows, ["", "n"], "stack")
        if rows
        else html.note("summary.json holds no error budget"),
    )
