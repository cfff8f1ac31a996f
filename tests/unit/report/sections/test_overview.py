"""The section of skipped work: steps that the design does not need, and what the others left out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from metafab.library import Library
from metafab.report.run_folder import RunFolder
from metafab.report.sections.overview import provenance, skipped
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
        ">a continuum<",
        "<code>[tolerance]</code>",
        ">none<",
        ">not measured<",
    ):
        assert text in page
    assert "drc" not in page


def test_two_pages_of_one_run_list_the_same_files(tmp_path: Path) -> None:
    """The records grow by the page's own entry after it is written; the page is then made again without a change."""
    (tmp_path / "psf.h5").write_bytes(b"x" * 1234)
    (tmp_path / "steps.json").write_bytes(b"{}")
    first = provenance(RunFolder(tmp_path))
    assert "psf.h5" in first
    for name in ("steps.json", "summary.json", "report.html"):
        (tmp_path / name).write_bytes(b"longer than before")
    assert provenance(RunFolder(tmp_path)) == first
