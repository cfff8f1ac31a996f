"""What full-wave rows found enters the error budget of the mask that they were cut from, and of no other."""

from __future__ import annotations

from pathlib import Path

import pytest

from metafab import fullwave
from metafab.core.storage.files import file_sha256
from metafab.fullwave.coupling import CouplingRow
from metafab.spec import Design
from metafab.steps import REPORT, error_budget, mask_paths, recorded_coupling
from metafab.steps.job import Job

ROW = CouplingRow(600.0, 0.0, "x", "y", "rcwa", 21, 1, 6.2, 0.8, 0.9, 0.03, 0.12, 0.01, 2.0)


@pytest.fixture
def job(tmp_path: Path, small_design: Design) -> Job:
    """A run folder with files in place of masks."""
    job = Job(small_design, tmp_path)
    for number, path in enumerate(mask_paths(job)):
        path.write_text(f"mask {number}")
    return job


def _line(coupling: dict[str, object]) -> dict[str, object]:
    light = {"error": [1e-3], "depth_interpolation_error": 1e-3, "field_interpolation_error": None}
    parts = {"library": {}, "layout": {"pillars": 1}, "psf": light, "decode": {}, "coupling": coupling}
    rows = {row["source"]: row for row in error_budget(parts)}
    return rows["local-period approximation"]


@pytest.mark.parametrize("which", [0, -1])
def test_rows_of_any_of_the_masks_count(job: Job, which: int) -> None:
    sha = file_sha256(mask_paths(job)[which])
    fullwave.save_coupling(fullwave.Coupling(sha, (ROW,)), job.folder / "coupling.json")
    found = recorded_coupling(job)
    assert found["coupling_error"] == pytest.approx(0.12)
    assert (found["rows"], found["solvers"]) == (1, ["rcwa"])
    assert _line(found)["value"] == pytest.approx(0.12)


def test_rows_of_another_mask_do_not(job: Job) -> None:
    fullwave.save_coupling(fullwave.Coupling("another", (ROW,)), job.folder / "coupling.json")
    assert recorded_coupling(job) == {}
    assert _line({})["value"] is None


def test_without_rows_nothing_is_measured_and_nothing_hashed(tmp_path: Path, small_design: Design) -> None:
    assert recorded_coupling(Job(small_design, tmp_path / "no masks here")) == {}


def test_the_page_is_made_again_when_they_come() -> None:
    assert REPORT.reads == ("coupling.json", "patch.h5", "tolerance.json")


@pytest.mark.parametrize("photographed", [True, False])
def test_what_only_a_photograph_meets_is_left_out_without_one(photographed: bool) -> None:
    light = {"error": [1e-3], "depth_interpolation_error": None, "field_interpolation_error": None}
    decoded = {"segments": 2} if photographed else {}
    rows = error_budget({"library": {"max_error": 1e-3}, "layout": {"pillars": 1}, "psf": light, "decode": decoded})
    sources = [row["source"] for row in rows]
    assert len(sources) == (8 if photographed else 5)
    assert ("decoder" in sources) == photographed
    assert "local-period approximation" in sources, "what was not measured but applies stays, as not measured"
