"""A worker of a cluster is killed in the middle of a library build and of a corner sweep: the result is the same."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from metafab import library
from metafab.core.parallel.executor import open_executor
from metafab.core.storage.files import file_sha256
from metafab.layout.pillars import PillarMap
from metafab.library import Library
from metafab.optics import WrittenField, written_field
from metafab.spec import UnitCell
from metafab.tolerance import corner_fields
from tests import optics_lens as lens
from tests.dask_workers import two_workers

pytest.importorskip("distributed")


class Killer:
    """A progress callback that kills one worker process when work comes in, once."""

    def __init__(self, cluster: Any) -> None:
        self.cluster = cluster
        self.killed: list[int] = []
        self.after: list[int] = []

    def __call__(self, what: str, done: int, total: int) -> None:
        if self.killed:
            self.after.append(done)
        elif 0 < done < total:
            victim = next(iter(self.cluster.workers.values()))
            self.killed.append(victim.pid)
            os.kill(victim.pid, signal.SIGKILL)


@pytest.fixture
def cluster() -> Iterator[Any]:
    """A scheduler with two worker processes on the loopback interface, which its nannies raise again."""
    with two_workers() as workers:
        yield workers


@pytest.fixture(scope="module")
def few_sizes(unit_cell: UnitCell) -> UnitCell:
    """25 sizes of the paper's cell, by the real solver in seconds."""
    sweep = replace(
        unit_cell.sweep, width_nm=(100.0, 140.0), length_nm=(100.0, 140.0), size_grid_nm=10.0, target_error=1e-2
    )
    return replace(unit_cell, sweep=sweep)


@pytest.fixture(scope="module")
def alone(few_sizes: UnitCell, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The library by one process."""
    path = tmp_path_factory.mktemp("alone") / "library.h5"
    library.build_file(few_sizes, path)
    return path


@pytest.mark.slow
def test_a_library_survives_its_worker(few_sizes: UnitCell, alone: Path, cluster: Any, tmp_path: Path) -> None:
    killer = Killer(cluster)
    with open_executor(cluster=cluster.scheduler_address) as executor:
        library.build_file(few_sizes, tmp_path / "library.h5", executor=executor, progress=killer)
    assert len(killer.killed) == 1
    assert killer.after, "work went on after the worker's death"
    assert file_sha256(tmp_path / "library.h5") == file_sha256(alone)


def _mask(of: Library) -> WrittenField:
    """Every size of the library somewhere on a lens."""
    width, length = (axis.ravel() for axis in np.meshgrid(of.width_nm, of.length_nm))
    sizes = np.concatenate([[(0, 0)], np.stack([2 * width, 2 * length], axis=1).round()]).astype(np.int32)
    lattice = lens.ideal(lens.imaging(), lens.eq_2(lens.imaging())).lattice
    index = np.random.default_rng(5).integers(1, len(sizes), lattice.shape).astype(np.uint16)
    return written_field(PillarMap.from_array(lattice, sizes, index, 50), of)


@pytest.mark.slow
def test_a_corner_sweep_survives_its_worker(alone: Path, cluster: Any) -> None:
    built = library.load(alone)
    mask, deviations = _mask(built), {"height_nm": 10.0, "cd_bias_nm": 4.0}
    here = corner_fields(mask, built, deviations)
    killer = Killer(cluster)
    with open_executor(cluster=cluster.scheduler_address) as executor:
        there = corner_fields(mask, built, deviations, executor=executor, progress=killer)
    assert len(killer.killed) == 1
    assert killer.after
    assert [corner.name for corner in there] == [corner.name for corner in here]
    for one, other in zip(here, there, strict=True):
        np.testing.assert_array_equal(one.field.table, other.field.table)
        assert (one.error, one.change, one.solved) == (other.error, other.change, other.solved)
