"""Error budget of a run: what full-wave rows found enters that of the mask that they were cut from alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest

from metafab import fullwave
from metafab.core.errors import SolverError
from metafab.core.figures import LightMapping, LineStatistics
from metafab.core.storage.files import file_sha256
from metafab.fullwave.coupling import Coupling, CouplingRow
from metafab.spec import Design, load_design, write_new
from metafab.spec.new import NewLens
from metafab.steps.images import DecodeFigures
from metafab.steps.job import Job
from metafab.steps.layout import LayoutFigures, mask_paths
from metafab.steps.optics import PsfFigures
from metafab.steps.orders import ORDERS, CouplingFigures, recorded_coupling
from metafab.steps.summary import BudgetLine, RunSummary, error_budget
from tests.closed_form_run import run_summary

ROW = CouplingRow(600.0, 0.0, "x", "y", "rcwa", 21, 1, 6.2, 0.8, 0.9, 0.03, 0.12, 0.01, 2.0)
LAYOUT = LayoutFigures(1, 1, None, 0.1, 0.9, 0.9, 0.9, 1.0, 1.0, 1.0, 0.9, 0.9, 0.9, (0.0, 0.0), ())
PSF = PsfFigures(
    depth_m=(0.3,),
    phi_deg=(0.0,),
    efficiency_x=(0.9,),
    efficiency_y=(0.9,),
    extinction_ratio=(100.0,),
    error=(1e-3,),
    depth_interpolation_error=None,
    field_interpolation_error=None,
    depths=1,
    block_sites=6.0,
    blocks=64.0,
    field_error=1e-3,
)


def test_the_budget_of_several_lights_is_that_of_the_worst() -> None:
    both = replace(LAYOUT, library_error=4e-3, phase_rms_error_rad=0.3), replace(LAYOUT, library_error=0.17)
    lights = tuple(LightMapping(633.0, 1.0, (0.0, 0.0), each) for each in both)
    solver, snapping, *_ = error_budget(RunSummary(layout=replace(both[0], lights=lights), psf=PSF))
    assert (solver.value, snapping.value) == (0.17, 0.3)
    assert solver.how.endswith("in the worst light")


def test_the_budget_of_an_imported_library_claims_no_error_of_its_solver() -> None:
    library = run_summary().library
    assert library is not None
    for rounds, name in ((3, "solver and library"), (0, "interpolation of the library")):
        line, *_ = error_budget(RunSummary(library=replace(library, rounds=rounds), layout=LAYOUT, psf=PSF))
        assert line.source == name
        assert ("certificate" in line.how) == (rounds > 0)
        assert ("is not known" in line.how) == (rounds == 0)


@pytest.fixture
def job(tmp_path: Path, small_design: Design) -> Job:
    """A run folder with files in place of masks."""
    job = Job(small_design, tmp_path)
    for number, path in enumerate(mask_paths(job)):
        path.write_text(f"mask {number}")
    return job


def _line(coupling: CouplingFigures | None) -> BudgetLine:
    lines = error_budget(RunSummary(layout=LAYOUT, psf=PSF, coupling=coupling))
    return next(line for line in lines if line.source == "local-period approximation")


@pytest.mark.parametrize(("which", "file"), [(0, "coupling.json"), (-1, "coupling.json"), (-1, "orders.json")])
def test_rows_of_any_of_the_masks_count(job: Job, which: int, file: str) -> None:
    """By ``metafab coupling``, or by the run itself for a steep lens."""
    sha = file_sha256(mask_paths(job)[which])
    fullwave.save_coupling(Coupling(sha, (ROW,)), job.folder / file)
    recorded = recorded_coupling(job)
    assert recorded is not None
    assert recorded.coupling_error == pytest.approx(0.12)
    assert (recorded.rows, recorded.solvers) == (1, ("rcwa",))
    assert _line(recorded).value == pytest.approx(0.12)


def test_rows_of_another_mask_do_not(job: Job) -> None:
    fullwave.save_coupling(Coupling("another", (ROW,)), job.folder / "coupling.json")
    assert recorded_coupling(job) is None
    assert _line(None).value is None


@pytest.mark.parametrize("aperture", [0.9, 0.0])
def test_rows_that_were_not_solved_are_a_line_of_the_summary(
    aperture: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A steep lens, and a pattern that repeats: the run goes on where the solver found no answer."""
    lens = NewLens(numerical_aperture=aperture, aperture_um=20.0) if aperture else None
    design = load_design(write_new("own", "metalens" if aperture else "deflector", tmp_path, lens=lens)[0])
    layout = tmp_path / "layout.oas"
    layout.write_bytes(b"a mask")
    monkeypatch.setattr("metafab.steps.orders.mask_source", Mock(side_effect=SolverError("a singular layer")))
    found = ORDERS.work(Job(design, tmp_path))
    assert found.sentence == "by the library alone: not solved (a singular layer)"


def test_the_rows_of_a_steep_lens_are_kept_with_its_mask(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lens = NewLens(numerical_aperture=0.9, aperture_um=20.0)
    job = Job(load_design(write_new("own", "metalens", tmp_path, lens=lens)[0]), tmp_path)
    for path in mask_paths(job):
        path.write_bytes(b"a mask")
    monkeypatch.setattr("metafab.steps.orders.mask_source", Mock())
    monkeypatch.setattr("metafab.steps.orders.open_library", Mock())
    monkeypatch.setattr(
        "metafab.fullwave.coupling.measure_rings", lambda _pillars, _library, _radius, sha, _: Coupling(sha, (ROW,))
    )
    found = ORDERS.work(job)
    assert (found.windows, found.coupling_error) == (1, pytest.approx(0.12))
    recorded = recorded_coupling(job)
    assert recorded is not None and recorded.rows == 1


def test_without_rows_nothing_is_measured_and_nothing_hashed(tmp_path: Path, small_design: Design) -> None:
    assert recorded_coupling(Job(small_design, tmp_path / "no masks here")) is None


@pytest.mark.parametrize("photographed", [True, False])
def test_what_only_a_photograph_meets_is_left_out_without_one(photographed: bool) -> None:
    decode = DecodeFigures(nmae=None, segments=()) if photographed else None
    sources = [line.source for line in error_budget(RunSummary(layout=LAYOUT, psf=PSF, decode=decode))]
    assert len(sources) == (9 if photographed else 5)
    assert ("decoder" in sources) == ("oblique light" in sources) == photographed
    assert "local-period approximation" in sources, "what was not measured but applies stays, as not measured"


def test_what_only_pillars_have_is_left_out_without_a_mask() -> None:
    sources = [line.source for line in error_budget(RunSummary(psf=PSF))]
    assert sources == ["pupil reduction and sampling"]


def test_the_model_of_neighbours_replaces_the_approximation_where_the_psf_used_it() -> None:
    summary = run_summary()
    assert summary.library is not None
    coupling, joint = CouplingFigures(0.12, 0.96, 1, ("rcwa",)), "joint effect of rows and columns"
    for light, windows, expected in (
        (PSF, None, {"local-period approximation": 0.12}),
        (replace(PSF, with_neighbours=True), 0.08, {"model of unlike neighbours": 0.03, joint: 0.08}),
        (replace(PSF, with_neighbours=True), None, {"model of unlike neighbours": 0.03, joint: None}),
    ):
        library = replace(summary.library, neighbours=LineStatistics(error_alike=0.03))
        psf = replace(light, joint_error=windows)
        lines = {
            line.source: line
            for line in error_budget(RunSummary(library=library, layout=LAYOUT, psf=psf, coupling=coupling))
        }
        found = {"local-period approximation", "model of unlike neighbours", joint} & lines.keys()
        assert {source: lines[source].value for source in found} == expected
        if joint in expected:
            assert ("not solved" in lines[joint].how) == (expected[joint] is None)
