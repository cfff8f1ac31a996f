"""Steps that read the same mask share its pillars and their field; another file, design or lens is read anew."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab import library, mask
from metafab.core.errors import InputError
from metafab.core.figures import LineStatistics
from metafab.core.parallel.work import Work
from metafab.layout import Aperture, lattice_of
from metafab.layout.pillars import PillarMap
from metafab.library.library import Library
from metafab.library.neighbours.line import LineShape, initial_model
from metafab.library.neighbours.model import Neighbours, TrainedLine
from metafab.optics import NeighbourField
from metafab.optics.sources.oblique import ObliqueField
from metafab.spec import Design
from metafab.spec.device import Optics
from metafab.steps.job import Job
from metafab.steps.library import library_path
from metafab.steps.optics import mask_source, pair_figures, point_spread, written_light
from metafab.steps.optics.sources import WrittenLens, joint_error, light_over_field


@pytest.fixture
def design(small_design: Design, smooth_library: Library, tmp_path: Path) -> Design:
    """The small design with a library in closed form."""
    library.save(smooth_library, tmp_path / "lib.h5")
    return replace(small_design, library=tmp_path / "lib.h5")


def _write_mask(design: Design, folder: Path, width_dbu: int) -> Path:
    """A mask of one pillar size."""
    lattice = lattice_of(design)
    sizes = np.array([[0, 0], [width_dbu, 400]], dtype=np.int32)
    whole = np.ones(lattice.shape, dtype=np.uint16)
    pillars = PillarMap.from_array(lattice, sizes, whole, design.numerics.tile_sites)
    mask.write(pillars, folder, design)
    return folder / "layout.oas"


def test_a_mask_is_read_once_until_something_changes(design: Design, tmp_path: Path) -> None:
    path = _write_mask(design, tmp_path / "run", 300)
    first = mask_source(Job(design, tmp_path), path).pillars
    # Another job of the same design, as the next command of a notebook makes one.
    assert mask_source(Job(design, tmp_path), path).pillars is first
    assert mask_source(Job(replace(design, name="other"), tmp_path), path).pillars is not first
    again = mask_source(Job(design, tmp_path), path).pillars
    _write_mask(design, tmp_path / "run", 320)
    os.utime(path, ns=(1, 1))
    changed = mask_source(Job(design, tmp_path), path).pillars
    assert changed is not again
    assert changed.size_nm().max() == again.size_nm().max() == 200.0
    assert changed.size_nm()[:, 0].max() == 160.0


def test_the_field_among_neighbours_is_shared_until_mask_or_library_change(
    design: Design, smooth_library: Library, tmp_path: Path
) -> None:
    line = TrainedLine(initial_model(LineShape(2, 1, 2), (100.0, 250.0), (100.0, 250.0), 1), LineStatistics())
    library.save(replace(smooth_library, neighbours=Neighbours((line, line), (line, line))), design.library)
    job = Job(replace(design, optics=Optics(neighbours=True)), tmp_path)
    path = _write_mask(design, tmp_path / "run", 300)
    field = written_light(job, path)
    assert isinstance(field, NeighbourField)
    assert written_light(job, path) is field
    os.utime(design.library, ns=(1, 1))
    assert written_light(job, path) is not field


@pytest.mark.parametrize(("error", "told"), [(0.2, True), (0.1, False)])
def test_light_by_a_model_that_does_not_pay_is_told(
    design: Design, smooth_library: Library, tmp_path: Path, error: float, told: bool
) -> None:
    statistics = LineStatistics(60, 6, local_period_error_alike=0.15, error_alike=error)
    line = TrainedLine(initial_model(LineShape(2, 1, 2), (100.0, 250.0), (100.0, 250.0), 1), statistics)
    library.save(replace(smooth_library, neighbours=Neighbours((line, line), (line, line))), design.library)
    path = _write_mask(design, tmp_path / "run", 300)
    for asked in (True, False):
        job = Job(replace(design, optics=Optics(neighbours=asked)), tmp_path)
        pair, _ = point_spread(job, WrittenLens(path), depths_m=(0.4,), window_px=16, target_error=0.1)
        sentences = [text for text in pair_figures(job, pair).warnings() if "does not lower the error: 0.200" in text]
        assert len(sentences) == (told and asked)
        assert all("`optics.neighbours`" in sentence for sentence in sentences)


@pytest.mark.parametrize(("rows", "told"), [(0, None), (40, "have no pillar in this file")])
def test_sites_without_pillars_are_told(design: Design, tmp_path: Path, rows: int, told: str | None) -> None:
    """The mask of a smaller lens passed for that of the design, with an efficiency of half a percent."""
    lattice = lattice_of(design)
    filled = Aperture.of(design).inside(0, 0, lattice.shape).astype(np.uint16)
    filled[:rows] = 0
    sizes = np.array([[0, 0], [300, 400]], dtype=np.int32)
    mask.write(PillarMap.from_array(lattice, sizes, filled, design.numerics.tile_sites), tmp_path / "run", design)
    lens, job = WrittenLens(tmp_path / "run" / "layout.oas"), Job(design, tmp_path)
    pair, _ = point_spread(job, lens, depths_m=(0.4,), window_px=16, target_error=0.1)
    figures = pair_figures(job, pair, lens=lens)
    share = 1.0 - filled.sum() / Aperture.of(design).count
    assert figures.empty_share == pytest.approx(share, abs=1e-12)
    sentences = [text for text in figures.warnings() if "count as dark" in text]
    assert len(sentences) == (told is not None)
    assert all(f"{100.0 * share:.3g} % of the sites" in text for text in sentences)


def test_a_missing_mask_says_so_before_any_library_is_built(small_design: Design, tmp_path: Path) -> None:
    unit_cell = tmp_path / "cell.toml"
    unit_cell.write_text("", encoding="utf-8")
    job = Job(replace(small_design, library=unit_cell), tmp_path)
    with pytest.raises(InputError, match=r"gone\.oas"):
        mask_source(job, tmp_path / "gone.oas")
    assert not library_path(job).exists()


def test_light_depends_on_its_direction_on_request_alone(design: Design, tmp_path: Path) -> None:
    """Without the key nothing is solved; with it once for all steps."""
    path = _write_mask(design, tmp_path, 300)
    job = Job(design, tmp_path / "run")
    straight = written_light(job, path)
    assert light_over_field(job, straight) is straight
    told: list[tuple[str, float, float]] = []
    work = Work(progress=lambda *what: told.append(what))
    asked = Job(replace(design, optics=Optics(oblique=True)), tmp_path / "run", work)
    first, second = (light_over_field(asked, straight) for _ in range(2))
    assert isinstance(first, ObliqueField)
    assert isinstance(second, ObliqueField)
    assert first.change is second.change
    assert first.change.coefficients[1].all()
    assert told == [("oblique light", done, told[-1][2]) for done in range(len(told))]
    assert told[-1][1] == told[-1][2] > 0
    with pytest.raises(InputError, match="directions with cosines up to"):
        light_over_field(Job(replace(asked.design, name="other"), tmp_path / "run", work), straight, [(0.5, 0.0)])
    assert told[-1][1] == len(told) - 1, "refused before any size is solved"


def test_the_error_budget_asks_for_light_at_angles(
    design: Design, smooth_library: Library, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By default where it changes the field by more than the model of neighbours errs, and within the field."""
    model, path = (
        initial_model(LineShape(2, 1, 2), (100.0, 250.0), (100.0, 250.0), 1),
        _write_mask(design, tmp_path, 300),
    )
    monkeypatch.setattr("metafab.library.use.oblique.oblique_field_error", lambda *_: 0.02)
    lights = {}
    for stated in (0.01, 0.03):
        line = TrainedLine(model, LineStatistics(error_alike=stated))
        library.save(replace(smooth_library, neighbours=Neighbours((line, line), (line, line))), design.library)
        os.utime(design.library, ns=(1, round(1e9 * stated)))
        for oblique, tangent in ((None, 0.0), (None, 0.5), (False, 0.0)):
            job = Job(replace(design, optics=Optics(neighbours=True, oblique=oblique)), tmp_path / "run")
            found = light_over_field(job, written_light(job, path), [(tangent, 0.0)])
            lights[stated, oblique, tangent] = isinstance(found, ObliqueField)
    assert [case for case, is_oblique in lights.items() if is_oblique] == [(0.01, None, 0.0)]


def test_the_joint_effect_is_that_of_a_few_windows_of_the_mask(
    design: Design, smooth_library: Library, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Root mean square over windows and lights; none where one is not solved, nor for pillars without neighbours."""
    model = initial_model(LineShape(2, 1, 2), (100.0, 250.0), (100.0, 250.0), 1)
    line, path = TrainedLine(model, LineStatistics()), _write_mask(design, tmp_path, 300)
    library.save(replace(smooth_library, neighbours=Neighbours((line, line), (line, line))), design.library)
    told: list[tuple[str, float, float]] = []
    work = Work(workers=1, progress=lambda *what: told.append(what))
    asked = Job(replace(design, optics=Optics(neighbours=True)), tmp_path / "run", work)
    light, sizes = written_light(asked, path), list[np.ndarray]()

    def share(_: Library, size_nm: np.ndarray) -> np.ndarray | None:
        sizes.append(size_nm)
        return np.array([0.03, 0.04]) * len(sizes) if len(sizes) <= 8 else None

    monkeypatch.setattr("metafab.library.neighbours.joint_share", share)
    found = joint_error(asked, light)
    assert found == pytest.approx(0.05 * np.sqrt(204 / 8 / 2))
    assert told[-1] == ("joint effect of neighbours", 8, 8)
    assert all(each.shape == (3, 3, 2) and each.all() for each in sizes)
    sizes += 9 * [sizes[0]]
    assert joint_error(asked, light) is None
    assert joint_error(asked, mask_source(asked, path)) is None
