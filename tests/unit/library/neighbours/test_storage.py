"""Chains in a file: what is written is read, and files of earlier versions give the same fields."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from metafab.core.figures import LineStatistics
from metafab.library.neighbours.blocks.cross import free_elements
from metafab.library.neighbours.line import PARAMETERS, LineShape, initial_model
from metafab.library.neighbours.model import Neighbours, TrainedLine
from metafab.library.neighbours.solve import line_corrections
from metafab.library.neighbours.storage import neighbours_of, put_neighbours


def test_chains_of_earlier_versions_hold_their_source(tmp_path: Path) -> None:
    model = initial_model(LineShape(2, 1, 2), (100.0, 250.0), (90.0, 200.0), 3)
    line = TrainedLine(model, LineStatistics(rows=10, held_out=2, error=0.1))
    with h5py.File(tmp_path / "lines.h5", "w") as file:
        put_neighbours(file.create_group("new"), Neighbours((line, line), (line, line), "inputs"))
        file.copy("new", "old")
        for group in file["old"].values():
            group["source"] = model.source
            del group["back_own"], group["back_side"]
        new, old = (neighbours_of(file[name]).along[0] for name in ("new", "old"))
        for group in file["old"].values():
            del group["site"]
        with pytest.raises(KeyError, match="site"):
            neighbours_of(file["old"])
    assert new.coupling is None
    assert new.statistics.rows == old.statistics.rows == 10
    assert all(np.array_equal(getattr(new.model, name), getattr(model, name)) for name in PARAMETERS)
    terms = model.polynomials(np.random.default_rng(1).uniform(100.0, 200.0, (3, 5, 2)))
    assert np.abs(line_corrections(old.model, terms) - line_corrections(model, terms)).max() < 1e-14


def test_couplings_of_blocks_are_read_as_written(tmp_path: Path) -> None:
    model = initial_model(LineShape(2, 1, 2), (100.0, 250.0), (90.0, 200.0), 3)
    pairs = model.shape.pairs[0].size
    line = TrainedLine(model, LineStatistics(), np.arange(pairs) + 1.0j)
    bare = Neighbours((line, line), (line, line), "inputs")
    neighbours = replace(bare, cross=np.arange(free_elements(bare)) - 2.0j)
    with h5py.File(tmp_path / "lines.h5", "w") as file:
        put_neighbours(file.create_group("lines"), neighbours)
        read = neighbours_of(file["lines"])
        assert read.along[0].coupling is not None
        assert read.cross is not None
        assert np.array_equal(read.along[0].coupling, np.arange(pairs) + 1.0j)
        assert np.array_equal(read.cross, np.arange(free_elements(bare)) - 2.0j)
        del file["lines/cross"]
        assert neighbours_of(file["lines"]).cross is None
        file["lines/cross"] = np.zeros(free_elements(bare) + 1, dtype=complex)
        with pytest.raises(KeyError, match="cross of shape"):
            neighbours_of(file["lines"])
