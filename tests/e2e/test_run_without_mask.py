"""A design that writes no mask: light, frame and depths of its target phases, and no pillar anywhere."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from metafab.core.errors import InputError
from metafab.core.parallel.work import Work
from metafab.core.storage.files import write_json
from metafab.optics import load
from metafab.run import run
from metafab.spec import Design, canonical_toml, load_design
from metafab.steps import Job, RunSummary, point_spread, write_layout
from metafab.steps.records import STEPS_FILE, FileMark, Record
from metafab.steps.stokes import full_stokes
from tests.main_job import SMALL

OF_PILLARS = ("library", "layout", "drc", "merit")


@pytest.fixture(scope="module")
def design() -> Design:
    whole = load_design(SMALL)
    return replace(whole, mask=replace(whole.mask, formats=()), verify=replace(whole.verify, field_points=(3, 3)))


@pytest.fixture(scope="module")
def done(design: Design, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, RunSummary]:
    folder = tmp_path_factory.mktemp("phases_alone")
    # What an earlier variant of the design left of its mask goes.
    (folder / "layout.oas").write_bytes(b"pillars")
    record = Record.of("", {"layout.oas": FileMark(7, "")}, {})
    write_json(folder / STEPS_FILE, {"layout": record})
    return folder, run(design, folder)


def test_depths_are_those_of_the_scene(done: tuple[Path, RunSummary]) -> None:
    decode, psf = done[1].decode, done[1].psf
    assert decode is not None and decode.worst_object_error is not None and decode.worst_object_error < 0.01
    assert decode.share_decoded is not None and decode.share_decoded > 0.98
    # Nothing is absorbed: all that came through the aperture is in the window or beside it.
    assert psf is not None and psf.transmitted_x == pytest.approx(1.0, abs=1e-3)


def test_nothing_is_said_of_pillars(done: tuple[Path, RunSummary]) -> None:
    folder, summary = done
    skipped = {entry.step: entry.why for entry in summary.skipped}
    assert all("no mask" in skipped[step] for step in (*OF_PILLARS, "tolerance"))
    assert all(summary.table()[step] == {} for step in OF_PILLARS)
    assert summary.violations == 0
    sources = [line.source for line in summary.error_budget]
    assert sources == ["pupil reduction and sampling", "depth interpolation", "field interpolation", "decoder"]
    files = {path.name for path in folder.iterdir()}
    assert not files & {"layout.oas", "layout.gds", "drc.json", "merit.json", "ideal_psf.h5"}
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "writes no mask" in page
    assert "written file" not in page
    assert 'id="mask"' not in page
    assert 'id="library"' not in page
    assert "not in the run folder" not in page


def test_a_second_run_does_nothing(design: Design, done: tuple[Path, RunSummary]) -> None:
    again = run(design, done[0])
    assert {entry.step for entry in again.skipped} >= {"phase", "study", "psf", "capture", "decode", "report"}


def test_the_pair_is_that_of_psf_ideal(design: Design, done: tuple[Path, RunSummary]) -> None:
    """``metafab psf --ideal`` of the same design, which has one way to its target phases."""
    stored = load(done[0] / "psf.h5")
    job = Job(design, done[0], Work(workers=1))
    depth_m = float(stored.depth_m[2])
    alone, _ = point_spread(
        job, None, depths_m=(depth_m,), object_mm=(0.0, 0.0), pixel_um=None, window_px=64, target_error=1e-3
    )
    assert alone.psf[0, 0] == pytest.approx(stored.psf[0, 2], abs=2e-3 * stored.psf.max())


def test_no_mask_is_written_where_none_is_asked_for(design: Design, tmp_path: Path) -> None:
    assert "formats = []" in canonical_toml(design)
    with pytest.raises(InputError, match=r"mask\.formats"):
        write_layout(Job(design, tmp_path))
    with pytest.raises(InputError, match=r"mask\.formats"):
        full_stokes(Job(design, tmp_path), row_angle_deg=8.0, angles=8, size_step_nm=20.0)
