"""A run that leaves nothing out gives the figures of one that leaves out what it may, within the stated errors."""

from __future__ import annotations

import shutil
from dataclasses import dataclass

import numpy as np
import pytest

from metafab import library, optics
from metafab.core.parallel.work import Work
from metafab.library import Library
from metafab.optics import Psf
from metafab.run import run
from metafab.spec import load_design
from metafab.spec.new import write_new
from metafab.steps import RESULT_STEPS, RunSummary

#: Steps whose results differ, and those that they need.
STEPS = [step for step in RESULT_STEPS if step.name in {"library", "phase", "layout", "psf", "capture", "decode"}]

#: The paper's cell on a grid of 6 nm.
UNIT_CELL = """
[cell]
period_nm = 350.0
height_nm = 600.0
shape = "rectangle"
[materials]
pillar = { n = 3.6941, k = 0.0065 }
substrate = { n = 1.7601 }
ambient = { n = 1.0 }
[illumination]
wavelength_nm = 800.0
side = "substrate"
[sweep]
width_nm = [100.0, 250.0]
length_nm = [100.0, 250.0]
size_grid_nm = 6.0
target_error = 0.05
"""


@dataclass(frozen=True)
class Outcome:
    """A finished run."""

    summary: RunSummary
    library: Library
    psf: Psf


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Outcome, Outcome]:
    """One camera of 0.1 mm with savings and without, and nothing else changed."""
    folder = tmp_path_factory.mktemp("no_skip")
    cell = folder / "cell.toml"
    cell.write_text(UNIT_CELL)
    file, *_ = write_new("camera", "camera", folder, library=cell)
    file.write_text(file.read_text().replace("aperture_um = 200.0", "aperture_um = 100.0", 1))
    design = load_design(file)
    outcomes = []
    for skips in (True, False):
        place = folder / f"skips_{skips}"
        summary = run(design, place, steps=STEPS, work=Work(workers=1), skips=skips)
        assert summary.library is not None
        built = library.load(place / summary.library.file)
        outcomes.append(Outcome(summary, built, optics.load(place / "psf.h5")))
    shutil.rmtree(folder)
    return outcomes[0], outcomes[1]


@pytest.mark.slow
def test_the_ledger_names_what_was_left_out(runs: tuple[Outcome, Outcome]) -> None:
    saving, whole = (outcome.summary for outcome in runs)
    left_out = {(entry.step, entry.what): entry for entry in saving.saved}
    cells = left_out["library", "unit cells"]
    assert saving.library is not None
    assert (cells.computed, cells.of) == (saving.library.points_solved, 26 * 26)
    assert cells.computed < 0.5 * 26 * 26
    assert cells.error is not None
    assert 0.0 < cells.error < 0.05
    assert left_out["psf", "places on the lens"].computed < left_out["psf", "places on the lens"].of  # type: ignore[operator]
    # Mirror images about the diagonal are the only sizes that a whole run need not solve.
    assert whole.library is not None
    assert whole.library.points_solved == 26 * 27 // 2
    assert whole.library.points_between == 0
    assert whole.psf is not None
    assert saving.psf is not None
    assert max(whole.psf.error) < 0.3 * max(saving.psf.error)
    assert whole.decode is not None
    assert whole.decode.step_px == 1


@pytest.mark.slow
def test_sizes_of_the_model_agree_with_the_solved_ones(runs: tuple[Outcome, Outcome]) -> None:
    saving, whole = (outcome.library for outcome in runs)
    for name in ("t_xx", "t_yy"):
        off = np.abs(getattr(saving, name) - getattr(whole, name))
        assert np.all(off <= saving.error + whole.error), name
    assert np.count_nonzero(saving.t_xx != whole.t_xx) > 200


@pytest.mark.slow
def test_light_and_depth_agree_within_the_stated_errors(runs: tuple[Outcome, Outcome]) -> None:
    saving, whole = runs
    at = np.array(whole.summary.psf.depth_m)  # type: ignore[union-attr]
    pairs = [outcome.psf.psf[:, np.isin(outcome.psf.depth_m, at)] for outcome in runs]
    # Two masks of slightly different libraries: both their sizes and their light carry the libraries' errors.
    layouts = [outcome.summary.layout for outcome in runs]
    bound = 2.0 * sum(layout.library_error for layout in layouts)  # type: ignore[union-attr, misc]
    bound += max(saving.summary.psf.error) + max(whole.summary.psf.error)  # type: ignore[union-attr]
    assert optics.relative_l2(pairs[0], pairs[1]) < bound
    for name in ("efficiency_x", "efficiency_y"):
        one, other = (np.array(getattr(outcome.summary.psf, name)) for outcome in runs)
        np.testing.assert_allclose(one, other, rtol=bound)
    segments = [outcome.summary.decode.segments for outcome in runs]  # type: ignore[union-attr]
    assert len(segments[0]) == len(segments[1]) == 2
    for one, other in zip(*(sorted(each, key=lambda s: s.depth_m) for each in segments), strict=True):
        assert abs(one.depth_m - other.depth_m) < 4.0 * (one.error_m + other.error_m)
