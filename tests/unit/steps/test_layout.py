"""Mask of a design, and the design rules of its biased copies."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from metafab.core.errors import InputError
from metafab.core.figures import LightMapping, LineStatistics
from metafab.core.storage.files import plain
from metafab.core.storage.tables import typed
from metafab.library import Library, save
from metafab.library.neighbours import Neighbours, TrainedLine
from metafab.library.neighbours.line import LineShape, initial_model
from metafab.spec import Exposure, load_design
from metafab.steps import Job, write_layout
from metafab.steps.layout import LAYOUT, LayoutFigures
from tests.main_job import SMALL, metafab

COPIES = "\n[[mask.copies]]\nat_um = [0.0, 0.0]\n[[mask.copies]]\nat_um = [40.0, 0.0]\nbias_nm = {bias}\n"


def job(folder: Path, library: Library, bias_nm: float) -> Job:
    """A lens of 20 um and a biased copy; sizes are up to 250 nm on a lattice of 350 nm."""
    save(library, folder / "library.h5")
    text = SMALL.read_text(encoding="utf-8").replace("../unitcell_lib/sos_800nm.toml", "library.h5")
    text = text.replace("aperture_um = 200.0", "aperture_um = 20.0").replace('optimise = "peak"', 'optimise = "none"')
    (folder / "design.toml").write_text(text + COPIES.format(bias=bias_nm), encoding="utf-8")
    return Job(load_design(folder / "design.toml"), folder)


def test_a_copy_that_breaks_a_rule_is_refused_when_it_is_laid_out(smooth_library: Library, tmp_path: Path) -> None:
    """10 nm more leave less than 100 nm between pillars; 10 nm less leave less than 100 nm of the smallest ones."""
    with pytest.raises(InputError, match=r"mask\.copies\[1\]\.bias_nm") as refused:
        write_layout(job(tmp_path, smooth_library, 10.0))
    assert "smallest gap 9" in str(refused.value)
    with pytest.raises(InputError, match=r"mask\.copies\[1\]\.bias_nm"):
        write_layout(job(tmp_path, smooth_library, -10.0))


def test_equal_copies_are_written_and_timed(smooth_library: Library, tmp_path: Path) -> None:
    made = job(tmp_path, smooth_library, 0.0)
    exposure = Exposure(1000.0, 2.0, shot_pitch_nm=4.0, drift_nm_per_min=1.0)
    design = replace(made.design, mask=replace(made.design.mask, exposure=exposure))
    figures = write_layout(Job(design, made.folder))
    assert {"layout.gds", "layout.oas"} <= {file.name for file in figures.files}
    time = figures.write_time
    assert time is not None and time.shots is not None
    assert time.trapezoids == 2 * figures.pillars < time.shots
    assert time.seconds == time.beam_seconds > 0.0
    assert figures == typed(LayoutFigures, plain(figures))
    # All files that are written are recorded, so that a deleted one is written again.
    recorded = {path.name for path in LAYOUT.outputs(Job(design, made.folder))}
    assert recorded == {path.name for path in made.folder.iterdir()} - {"library.h5", "design.toml"}
    assert "fields.csv" in recorded


def test_pillars_of_unknown_response_are_told_at_each_wavelength(smooth_library: Library, tmp_path: Path) -> None:
    own = replace(write_layout(job(tmp_path, smooth_library, 0.0)), doubtful_pillars=0)
    blue = replace(own, doubtful_pillars=own.pillars // 2, worst_library_error=0.3)
    lights = tuple(LightMapping(nm, 1.0, (0.0, 0.0), each) for nm, each in ((460.0, blue), (800.0, own)))
    (told,) = replace(own, lights=lights).warnings()
    assert told.startswith("at 460 nm, 50 % of the pillars")
    assert own.warnings() == []


@pytest.mark.parametrize(("rule", "error", "told"), [(True, 0.2, True), (True, 0.1, False), (False, 0.2, False)])
def test_sizes_chosen_by_a_model_that_does_not_pay_are_told(
    smooth_library: Library, tmp_path: Path, rule: bool, error: float, told: bool
) -> None:
    """By ``metafab run``, which announces the figures' warnings, and by ``metafab layout``."""
    statistics = LineStatistics(60, 6, local_period_error_alike=0.15, error_alike=error)
    models = [initial_model(LineShape(2, 1, 1), (100.0, 250.0), (100.0, 250.0), seed) for seed in (1, 2)]
    along, across = (TrainedLine(model, statistics) for model in models)
    library = replace(smooth_library, neighbours=Neighbours((along, along), (across, across)))
    made = job(tmp_path, library, 0.0)
    figures = write_layout(Job(replace(made.design, rules=replace(made.design.rules, neighbours=rule)), made.folder))
    sentences = [sentence for sentence in figures.warnings() if "does not lower the error: 0.200" in sentence]
    assert len(sentences) == told
    assert all("`rules.neighbours`" in sentence for sentence in sentences)
    assert figures == typed(LayoutFigures, plain(figures))
    design = made.folder / "design.toml"
    text = design.read_text(encoding="utf-8").replace("[rules]", f"[rules]\nneighbours = {str(rule).lower()}")
    design.write_text(text, encoding="utf-8")
    answer = metafab("layout", design, "-o", tmp_path / "out", "--json")
    assert answer.code == 0, answer.stderr
    assert ("`rules.neighbours`" in answer.stderr) == told
    assert ("neighbour_warning" in answer.json) == told
