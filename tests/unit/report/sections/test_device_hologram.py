"""A hologram's page: its figures, and the wanted picture beside the painted one; a panel a unit in the error budget."""

from __future__ import annotations

import dataclasses
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from metafab.core.figures import PhaseFigures
from metafab.core.parallel.progress import silent
from metafab.library.library import Library
from metafab.report.draw import draw
from metafab.report.figures import phases as figures
from metafab.report.run_folder import RunFolder
from metafab.report.sections.device import phases
from metafab.report.sections.images import imaging
from metafab.report.sections.light import point_spread
from metafab.report.sections.overview import accounts, headlines
from metafab.spec import load_design, write_new
from tests.closed_form_run import closed_form_run, turning_psf


@pytest.fixture
def run(tmp_path: Path, smooth_library: Library) -> RunFolder:
    design = load_design(write_new("mine", "hologram", tmp_path)[0])
    run = closed_form_run(tmp_path, smooth_library)
    phase = PhaseFigures(hologram_efficiency=0.791, hologram_correlation=0.97)
    return dataclasses.replace(run, design=design, summary=dataclasses.replace(run.summary, phase=phase))


def test_the_picture_is_shown_as_wanted_and_as_painted(run: RunFolder) -> None:
    drawn = draw(run, silent, workers=1)
    page = phases(run, drawn)
    assert page.index(drawn["hologram_wanted"]) < page.index(drawn["hologram_found"])
    assert "0.791</b> of the light in the picture" in page
    assert "0.97</b> correlation with the picture" in page
    assert "79\u202f%" in headlines(run)


def test_both_pictures_have_one_scale_and_stand_upright() -> None:
    picture = np.zeros((40, 60))
    picture[:10, :15] = 3.0  # the top left corner
    psf = turning_psf()
    reach_um = 0.5 * psf.psf.shape[-1] * psf.pixel_um
    wanted, found = (Figure().add_subplot() for _ in range(2))
    figures.wanted_picture(picture, 30.0, reach_um, wanted)
    figures.painted_picture(psf, found, "x")
    assert wanted.get_xlim() == found.get_xlim() == (-reach_um, reach_um)
    dark, shown = wanted.images
    assert tuple(dark.get_extent()) == (-reach_um, reach_um, -reach_um, reach_um)
    assert tuple(shown.get_extent()) == (-15.0, 15.0, -10.0, 10.0)
    assert np.asarray(shown.get_array())[-1, 0] == 1.0  # the last row is the highest


def test_each_unit_with_several_errors_has_a_panel(run: RunFolder) -> None:
    drawn = draw(run, silent, workers=1)
    page = accounts(run, drawn)
    panels = [name for name in drawn if name.startswith("error_budget")]
    assert all(drawn[name] in page for name in panels)
    # Lines that were not measured have no bar, and one bar alone is left to the table.
    measured = Counter(line.unit for line in run.summary.error_budget if line.value)
    several = [unit for unit, count in measured.items() if count > 1]
    assert 0 < len(several) < len(measured)
    for name, unit in zip(panels, several, strict=True):
        assert unit in drawn[name]


def test_a_hologram_has_no_arrows_and_no_modulation_transfer(run: RunFolder) -> None:
    painted = dataclasses.replace(run, outline=dataclasses.replace(run.outline, terms=("lens", "hologram")))
    assert not painted.outline.has_lobe
    assert "psf_mtf" not in draw(painted, silent, workers=1)
    assert "arrows point" not in point_spread(painted, {})
    assert "arrows point" in point_spread(run, {})


def test_the_raw_frame_shrinks_with_the_screen(run: RunFolder) -> None:
    page = imaging(run, {"raw_frame": "<svg/>"})
    assert '<div class="fit"><figure><svg/>' in page
