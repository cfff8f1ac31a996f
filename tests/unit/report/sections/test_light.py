"""Figures of merit and corners on the page: in readers' words, and whatever a summary holds."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab.core.figures import LightMapping, ToleranceRow, ToleranceTable
from metafab.core.storage.tables import typed
from metafab.library import Library
from metafab.report.run_folder import DesignOutline, RunFolder
from metafab.report.sections.light import point_spread, tolerances
from metafab.report.sections.overview import subtitle
from metafab.steps.optics import PairFigures
from metafab.steps.optics.lights import LightFigures, LightsFigures
from metafab.steps.summary import RunSummary
from tests.closed_form_run import closed_form_run, turning_psf

ROW = ToleranceRow(
    corner="cd_bias_nm -10",
    change=0.2291,
    peak_ratio=1.0,
    efficiency=0.8569,
    efficiency_change=0.0,
    extinction_ratio=2396.35,
    turn_deg=-0.4876,
    depth_error_m=0.0005,
    relative_error=0.0029,
    draws=0,
    solved=1,
    below_error=False,
)


def _page(*rows: ToleranceRow) -> str:
    figures = ToleranceTable(np.array([0.25, 0.34]), 1e-3, 6, rows[0], rows)
    # Through its file and back, as the page reads it.
    table = json.loads(json.dumps(RunSummary(tolerance=figures).table()))
    return tolerances(RunFolder(Path(), summary=RunSummary(tolerance=typed(ToleranceTable, table["tolerance"]))))


@pytest.mark.parametrize(
    ("corner", "text"),
    [
        ("cd_bias_nm -10", "CD bias −10 nm"),
        ("height_nm +10", "height +10 nm"),
        ("sidewall_angle_deg -2", "sidewall −2°"),
        ("pillar_n_shift +0.0135", "pillar index +0.0135"),
        ("missing 1 per mille", "missing 1 per mille"),
    ],
)
def test_corners_are_named_for_readers(corner: str, text: str) -> None:
    assert f">{text}</td>" in _page(replace(ROW, corner=corner))


def test_figures_of_corners_stand_in_line() -> None:
    page = _page(ROW)
    for cell in ("1.000", "0.857", "2\u202f396", "−0.49", "0.2", "0.29\u202f%"):
        assert f">{cell}</td>" in page


def test_what_is_no_number_is_shown_as_such() -> None:
    """A summary has null where a pair does not turn, and "inf" where nothing is unwanted: a dash and ∞."""
    page = _page(ROW, replace(ROW, extinction_ratio=math.inf, depth_error_m=math.nan))
    assert ">∞</td>" in page
    assert ">–</td>" in page


def test_a_lens_has_a_focus_in_place_of_a_pair() -> None:
    none = {"extinction_ratio": math.nan, "turn_deg": math.nan, "depth_error_m": math.nan}
    page = _page(replace(ROW, fwhm_x_um=0.4541, fwhm_y_um=0.4309, strehl=0.9761, **none))
    for text in ("FWHM along x", ">0.4541</td>", ">0.4309</td>", ">0.976</td>", "0.4541 and 0.4309 µm wide"):
        assert text in page
    assert not any(text in page for text in ("extinction</th>", "rotation", "Depth error", ">–</td>"))
    assert "FWHM" not in _page(ROW)


def test_a_change_below_the_error_is_told_so() -> None:
    page = _page(replace(ROW, below_error=True))
    assert ">below error</td>" in page and ">0.29\u202f%</td>" not in page


def test_nobody_asked_for_corners() -> None:
    assert tolerances(RunFolder(Path())) == ""


def test_each_wavelength_of_a_mask_stands_in_full(tmp_path: Path, smooth_library: Library) -> None:
    """Neighbouring laser lines differ in the fourth digit."""
    run, pair = closed_form_run(tmp_path, smooth_library), PairFigures.of(turning_psf())
    wavelengths = (1549.6, 1550.4, 632.8)
    lights = LightsFigures(tuple(LightFigures(each, "psf.h5", pair, (0.9,), (0.8,)) for each in wavelengths))
    page = point_spread(replace(run, summary=replace(run.summary, lights=lights)), {})
    share = f"{0.5 * (pair.efficiency_x[0] + pair.efficiency_y[0]):.3f}"
    for cell in ("1549.6 nm", "1550.4 nm", "632.8 nm", share, "0.850", "–"):
        assert f">{cell}</td>" in page
    own = run.summary.layout
    assert own is not None
    mapped = tuple(LightMapping(each, 1.0, (0.0, 0.0), replace(own, library_error=0.17)) for each in wavelengths)
    summary = replace(run.summary, lights=lights, layout=replace(own, lights=mapped))
    assert point_spread(replace(run, summary=summary), {}).count(">0.17</td>") == 3


def test_the_first_line_names_every_light(tmp_path: Path) -> None:
    (tmp_path / "design.toml").write_text(
        "[[light]]\nwavelength_nm = 633.0\n[[light]]\nwavelength_nm = 633.0\nangle_x_deg = 10.0\n"
    )
    outline = DesignOutline.load(tmp_path / "design.toml")
    assert "633 nm; 633 nm, 10 deg in x-z" in subtitle(RunFolder(tmp_path, outline=outline))


def test_the_page_says_where_the_light_is_that_misses_the_window(tmp_path: Path, smooth_library: Library) -> None:
    run = closed_form_run(tmp_path, smooth_library)
    assert run.summary.psf is not None
    assert "misses the light" not in point_spread(run, {})
    missed = replace(run.summary.psf, light_at_um=((-102.7, 0.505), (-102.7, 0.505)))
    page = point_spread(replace(run, summary=replace(run.summary, psf=missed)), {})
    assert "(-102.7, 0.505)" in page and "verify.centre_um" in page
