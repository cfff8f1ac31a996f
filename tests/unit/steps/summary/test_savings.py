"""Work that a run left out, with its numbers and its error."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import Mock

from metafab.core.figures import LineStatistics
from metafab.spec import Design
from metafab.spec.device import Optics
from metafab.steps.summary import RunSummary, Saving, savings
from tests.closed_form_run import run_summary
from tests.unit.steps.summary.test_budget import LAYOUT, PSF


def test_a_run_without_figures_saves_nothing(small_design: Design) -> None:
    assert savings(small_design, RunSummary()) == ()


def test_each_saving_has_its_numbers_and_its_error(small_design: Design) -> None:
    summary = run_summary()
    assert summary.library is not None
    library = replace(summary.library, max_model_error=3e-4)
    found = savings(small_design, replace(summary, library=library))
    cells = found[0]
    assert (cells.step, cells.computed, cells.of, cells.error) == ("library", 120, 5776, 3e-4)
    by_name = {(entry.step, entry.what): entry for entry in found}
    depths = by_name["psf", "depths"]
    assert depths.of is None
    rows, columns = small_design.scene.field_px if small_design.scene else (0, 0)
    assert by_name["psf", "directions of the field"].of == rows * columns


def test_light_at_angles_that_is_left_out_has_its_reason(small_design: Design) -> None:
    left_out, name = replace(PSF, oblique_error=0.02), "angles of the light on pillars"
    model = replace(run_summary().library or Mock(), neighbours=LineStatistics(error_alike=0.03))
    among = replace(left_out, with_neighbours=True)
    refused = replace(small_design, optics=Optics(oblique=False))
    for design, psf, reason in (
        (small_design, left_out, "which the library does not know"),
        (small_design, among, "errs by more, 0.03"),
        (refused, among, "`optics.oblique` is false"),
    ):
        left_out_work = savings(design, RunSummary(library=model, layout=LAYOUT, psf=psf))
        (found,) = (entry for entry in left_out_work if entry.what == name)
        assert reason in found.why
        assert found.error == 0.02
    carried = replace(left_out, oblique_change=0.09)
    assert name not in {
        each.what for each in savings(small_design, RunSummary(library=model, layout=LAYOUT, psf=carried))
    }


def test_one_direction_of_the_field_is_named_and_its_error_is_not_measured(small_design: Design) -> None:
    design = replace(small_design, verify=replace(small_design.verify, field_points=(1, 1)))
    found = {entry.what: entry for entry in savings(design, RunSummary(layout=LAYOUT, psf=PSF))}
    field = found["directions of the field"]
    assert (field.computed, field.why, field.error) == (1, "one direction serves all", None)
    assert field.error_of is not None and found["depths"].error_of is not None, "not lossless, but not measured"


def test_mirror_images_alone_lose_nothing(small_design: Design) -> None:
    library = run_summary().library
    assert library is not None
    (only,) = savings(small_design, RunSummary(library=replace(library, max_model_error=0.0)))
    assert only == Saving(
        "library", "unit cells", 120, 5776, "mirror images about the diagonal exchange x and y polarisation"
    )
