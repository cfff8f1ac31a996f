"""Library files with the model of neighbours that their unit cell asks for, or without one."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab.core.figures import LineStatistics
from metafab.library import build_file, built, is_current, load, save
from metafab.library.library import Library, inputs_of
from metafab.library.neighbours.line import LineShape, initial_model
from metafab.library.neighbours.model import Neighbours, TrainedLine
from metafab.library.neighbours.training import inputs_of_training
from metafab.spec.cell import Neighbours as Training


def _train(library: Library, *, checkpoint: Path | None = None, **_: object) -> Neighbours:
    """Chains of random parameters in place of a training, whose rows and fits stay in files."""
    if checkpoint is not None:
        for suffix in (".rows", ".0123abcd.fits"):
            checkpoint.with_suffix(suffix).touch()
    line = TrainedLine(initial_model(LineShape(2, 1, 1), (100.0, 250.0), (100.0, 250.0), 1), LineStatistics(10, 2, 0.5))
    return Neighbours((line, line), (line, line), inputs_of_training(library.unit_cell))


def test_the_model_follows_the_unit_cell(
    smooth_library: Library, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(built, "train", _train)
    path, lone = tmp_path / "library.h5", smooth_library.unit_cell
    save(replace(smooth_library, inputs_sha256=inputs_of(lone)), path)
    before = path.read_bytes()
    assert is_current(path, lone)

    asked = replace(lone, neighbours=Training(rows=100))
    assert not is_current(path, asked)
    trained = build_file(asked, path)
    assert trained.neighbours is not None and trained.neighbours.pays
    # The pillars were kept: building them would have replaced the closed form.
    assert np.array_equal(trained.t_xx, smooth_library.t_xx)
    assert is_current(path, asked)
    assert {each.suffix for each in tmp_path.iterdir()} == {".h5", ".rows"}  # fits are of no use any more
    assert not is_current(path, replace(lone, neighbours=Training(rows=200)))
    stored = load(path)
    assert stored.unit_cell == asked
    assert stored.neighbours is not None
    assert stored.neighbours.along[0].statistics.rows == 10

    assert not is_current(path, lone)
    assert build_file(lone, path).neighbours is None
    assert is_current(path, lone)
    assert path.read_bytes() == before


def test_a_model_that_is_worse_than_lone_pillars_is_said_not_to_pay(smooth_library: Library) -> None:
    good = _train(smooth_library)
    worse = replace(good.along[0], statistics=LineStatistics(60, 6, local_period_error=0.45, error=0.91))
    bad = replace(good, along=(worse, worse))
    assert good.pays and not bad.pays
    (sentence,) = replace(smooth_library, neighbours=bad).warnings()
    assert "does not lower the error" in sentence and "neighbours.rows" in sentence
    assert replace(smooth_library, neighbours=good).warnings() == []


@pytest.mark.parametrize(
    ("error_alike", "alone", "pays"),
    [(0.10, 0.15, True), (0.20, 0.15, False), (0.10, math.nan, False)],
    ids=["better as in a lens", "worse as in a lens", "older file"],
)
def test_rows_as_in_a_lens_decide_whether_a_model_pays(
    smooth_library: Library, tmp_path: Path, error_alike: float, alone: float, pays: bool
) -> None:
    """On all rows together, random ones included, the chain is worse; only files of older trainings count that."""
    statistics = LineStatistics(
        60, 6, local_period_error=0.4, error=0.5, error_alike=error_alike, local_period_error_alike=alone
    )
    line = replace(_train(smooth_library).along[0], statistics=statistics)
    save(replace(smooth_library, neighbours=Neighbours((line, line), (line, line))), tmp_path / "library.h5")
    read = load(tmp_path / "library.h5")
    assert read.neighbours is not None and read.neighbours.pays == pays
    told = {(0.20, 0.15): "0.200 of the field on held-out rows, 0.150 without it", (0.10, math.nan): "0.500 of the"}
    assert [told[error_alike, alone] in sentence for sentence in read.warnings()] == ([] if pays else [True])
