"""Figures of the study and of proposals: what is drawn is what the results say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab.core.figures import Remedy
from metafab.phase.optimise.rotation import MainLobe
from metafab.phase.studies.bandwidth import BandwidthBudget, BandwidthTradeoff
from metafab.phase.studies.compare import DepthBounds
from metafab.phase.studies.propose import Proposal
from metafab.phase.studies.study import LobeOverDepth, PhaseStudy
from metafab.report import proposal_figure
from metafab.report.draw import draw
from metafab.report.figures import study as figures
from metafab.report.run_folder import RunFolder
from metafab.report.sections.device import phases
from metafab.report.style import panel
from metafab.steps.phase import FilterFigures, StudyFigures
from metafab.steps.summary import RunSummary

DEPTH_M = np.linspace(0.25, 0.5, 6)


@pytest.fixture(scope="module")
def study() -> PhaseStudy:
    vergence = np.linspace(-2.0, 2.0, 9)
    lobe = MainLobe(vergence, 0.2 + 0.01 * vergence, np.ones(9), -50.0 * vergence)
    plain = replace(lobe, peak=0.5 * lobe.peak)
    point = np.outer([1.0, 5.0], DEPTH_M) * 1e-3
    texture = np.stack([DEPTH_M * 1e-3, np.full(6, np.inf)])
    curves = BandwidthTradeoff(
        np.array([1.0, 5.0, 10.0]), np.array([2.0, 8.0]), np.ones((2, 3)), np.ones((2, 3)) * 0.5,
        np.array([[3.0, 2.0, 1.0], [4.0, 3.0, 5.0]]),
    )  # fmt: skip
    azimuth = np.array([0.0, 90.0, 180.0, 270.0])
    remedies = (Remedy("a split of 2 degrees", 0.9, 0.4),)
    budget = BandwidthBudget(10.0, 8.0, 3.8, 38.0, 0.25, remedies, curves, azimuth, np.array([0.25, 0.5, 0.4, 0.5]))
    return PhaseStudy(
        LobeOverDepth(vergence, lobe, plain, -50.0 * vergence, (-0.5, 1.0)),
        DepthBounds(DEPTH_M, ("this design", "standard lens"), point, texture),
        budget,
    )


def test_the_lobe_before_and_after(study: PhaseStudy) -> None:
    assert study.lobe is not None
    _, axes = panel()
    figures.lobe_peak(study.lobe, axes)
    before, after = axes.lines
    np.testing.assert_array_equal(after.get_ydata(), 2.0 * np.asarray(before.get_ydata()))
    assert axes.get_ylim()[1] > study.lobe.design.peak.max()
    _, axes = panel()
    figures.lobe_orientation(study.lobe, axes)
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), study.lobe.law_deg)
    np.testing.assert_array_equal(axes.lines[1].get_ydata(), study.lobe.design.phi_deg)


def test_bounds_are_in_millimetres_and_a_blind_mask_is_named(study: PhaseStudy) -> None:
    assert study.bounds is not None
    _, axes = panel()
    figures.depth_bounds(study.bounds, axes, "point")
    np.testing.assert_allclose(np.asarray(axes.lines[1].get_ydata(), dtype=float), 5.0 * DEPTH_M)
    np.testing.assert_allclose(np.asarray(axes.lines[1].get_xdata(), dtype=float), 100.0 * DEPTH_M)  # centimetres
    _, axes = panel()
    figures.depth_bounds(study.bounds, axes, "texture")
    legend = axes.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["this design", "standard lens: nothing"]


def test_bounds_of_masks_that_tell_nothing_at_all_can_be_drawn(study: PhaseStudy) -> None:
    assert study.bounds is not None
    blind = replace(study.bounds, texture_m=np.full((2, 6), np.inf))
    figure, axes = panel()
    figures.depth_bounds(blind, axes, "texture")
    figure.canvas.draw()


def test_the_filter_marks_the_design(study: PhaseStudy) -> None:
    assert study.bandwidth is not None
    _, axes = panel()
    figures.filter_tradeoff(study.bandwidth, axes)
    *curves, mark = axes.lines
    assert [line.get_label() for line in curves] == ["split by 8°", "split by 2°"]
    assert (np.asarray(mark.get_xdata())[0], np.asarray(mark.get_ydata())[0]) == (10.0, 5.0)
    _, axes = panel()
    figures.filter_orientation(study.bandwidth, axes)
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), [0.25, 0.5, 0.4, 0.5, 0.25])  # closed


def test_the_page_shows_what_is_there_and_no_more(study: PhaseStudy, tmp_path: Path) -> None:
    budget = FilterFigures(10.0, 3.8, 38.0, 0.25, 2.0, (Remedy("a <split>", 0.9, 0.4),))
    run = RunFolder(tmp_path, RunSummary(study=StudyFigures(budget)), study=study)
    drawn = draw(run, lambda step, done, total: None)
    assert {"lobe_peak", "bounds_point", "bounds_texture", "filter", "filter_orientation"} <= drawn.keys()
    assert all((tmp_path / "figures" / f"{name}.png").is_file() for name in drawn)
    page = phases(run, drawn)
    assert "Colour filter" in page
    assert "a &lt;split&gt;" in page
    bare = RunFolder(tmp_path, study=PhaseStudy(None, None, None))
    drawn = draw(bare, lambda step, done, total: None)
    assert drawn == {}
    assert "Colour filter" not in phases(bare, drawn)


def test_proposals_are_drawn_best_first(tmp_path: Path) -> None:
    found = [
        Proposal(zones, 0.5, 0.33, 90.0, -56.0, 6.4, DEPTH_M, 100.0 * DEPTH_M, 1e-3 * zones * DEPTH_M)
        for zones in range(2, 10)
    ]
    _, axes = panel()
    figures.proposed_bounds(found, axes)
    assert len(axes.lines) == 5, "more would hide each other"
    np.testing.assert_allclose(np.asarray(axes.lines[0].get_ydata(), dtype=float), 0.2)  # per cent
    assert proposal_figure(found, tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")
