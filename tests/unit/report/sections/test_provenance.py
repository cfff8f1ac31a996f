"""The section of skipped work: steps that the design does not need, and what the others left out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from metafab.library import Library
from metafab.report.sections.provenance import skipped
from metafab.steps.summary import UNCHANGED, Saving, SkippedStep
from tests.closed_form_run import closed_form_run


def test_savings_stand_with_their_numbers_and_errors(tmp_path: Path, smooth_library: Library) -> None:
    run = closed_form_run(tmp_path, smooth_library)
    saved = (
        Saving("library", "unit cells", 120, 5776, "a <model>", 3.1e-4, "complex t"),
        Saving("psf", "d", 12, None, "w"),
        Saving("psf", "e", 1, 9, "w", None, "relative L2"),
    )
    steps = (SkippedStep("tolerance", "no `[tolerance]`"), SkippedStep("drc", UNCHANGED))
    page = skipped(replace(run, summary=replace(run.summary, saved=saved, skipped=steps)))
    for text in (
        "5\u202f776",
        "a &lt;model&gt;",
        "0.00031 (complex t)",
        ">any<",
        "<code>[tolerance]</code>",
        ">none<",
        ">not measured<",
    ):
        assert text in page
    assert "drc" not in page
