"""The comparison's figures and its section of the page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from metafab.comparison import Comparison, comparison_figures, save_comparison
from metafab.report import comparison_figure
from metafab.report.draw import draw
from metafab.report.figures import study as figures
from metafab.report.run_folder import RunFolder, open_run
from metafab.report.sections import images
from metafab.report.style import panel

METHODS = ("this design", "standard lens", "lens, focused nearer", "double helix", "double helix, cepstrum")


@pytest.fixture
def comparison() -> Comparison:
    error = np.outer(1e-3 * np.arange(1, 6), [1.0, 2.0, 3.0])
    return Comparison(
        np.array([0.25, 0.3, 0.4]), 96, 3000.0, 2.0, 0.25, 6, METHODS, error, 0.1 * error, METHODS[:4], error[:4]
    )


def test_errors_are_drawn_in_per_cent_with_their_bounds(comparison: Comparison, tmp_path: Path) -> None:
    _, axes = panel()
    figures.rival_depth_errors(comparison, axes)
    # Each error with its bound, and a dotted line for the legend alone.
    assert len(axes.lines) == 11
    shown = axes.get_legend()
    assert shown is not None
    dotted = dict(zip([text.get_text() for text in shown.get_texts()], shown.get_lines(), strict=True))["bound of each"]
    assert dotted.get_linestyle() == axes.lines[1].get_linestyle() == ":"
    np.testing.assert_allclose(np.asarray(axes.lines[0].get_ydata(), dtype=float), [0.1, 0.2, 0.3])
    np.testing.assert_allclose(np.asarray(axes.lines[1].get_ydata(), dtype=float), [0.01, 0.02, 0.03])
    # Bars of the scatter: six errors give their rms to 1 / sqrt(12).
    bars = np.array(axes.collections[0].get_segments())
    np.testing.assert_allclose(bars[:, 1, 1] / bars[:, 0, 1], (1.0 + 12**-0.5) / (1.0 - 12**-0.5))
    assert comparison.error_scatter == comparison_figures(comparison).error_scatter == pytest.approx(12**-0.5)
    _, axes = panel()
    figures.rival_sharpness(comparison, axes)
    assert [line.get_label() for line in axes.lines] == list(METHODS[:4])
    assert comparison_figure(comparison, tmp_path / "c.png").read_bytes().startswith(b"\x89PNG")


def test_the_page_shows_it_where_its_file_is(comparison: Comparison, tmp_path: Path) -> None:
    assert images.comparison(RunFolder(tmp_path), {}) == ""
    save_comparison(comparison, tmp_path / "comparison.json")
    run = RunFolder(tmp_path, comparison=open_run(tmp_path).comparison)
    drawn = draw(run, lambda step, done, total: None, workers=1)
    assert set(drawn) == {"rival_depth", "rival_sharpness"}
    page = images.comparison(run, drawn)
    assert "double helix, cepstrum" in page
    assert page.count("<svg") == 2
