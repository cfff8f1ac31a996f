"""Tiles on a cluster: two worker processes on this machine, identical bytes, and a worker that dies on its tile."""

from __future__ import annotations

import os
import resource
import signal
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab import drc, layout, mask
from metafab.core.errors import InputError
from metafab.core.parallel.cluster import ClusterExecutor
from metafab.core.parallel.executor import in_order, open_executor
from metafab.core.parallel.work import Work
from metafab.layout import Assignment
from metafab.library import Library
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Copy, Design
from tests.dask_workers import two_workers
from tests.layout.conftest import sizes_at_sites

pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """Address of a scheduler with two worker processes."""
    with two_workers() as workers:
        yield workers.scheduler_address


@pytest.mark.parametrize("kept_sites", [0, 1 << 27], ids=["mapped again where it is written", "kept"])
def test_a_cluster_maps_and_writes_the_same_bytes(
    kept_sites: int, cluster: str, tiny: Assignment, tiny_files: dict[str, Path], profile: PhaseProfile,
    smooth_library: Library, tiny_design: Design, tmp_path: Path,
) -> None:  # fmt: skip
    with open_executor(cluster=cluster) as executor:
        assert isinstance(executor, ClusterExecutor)
        assert executor.slots == 2
        mapped = layout.assign(profile, smooth_library, tiny_design, executor=executor, kept_sites=kept_sites)
        written = mask.write(mapped.pillars, tmp_path, tiny_design, executor=executor)
        assert np.array_equal(sizes_at_sites(mapped.pillars), sizes_at_sites(tiny.pillars))
    assert mapped.figures == tiny.figures
    for file in written[:2]:
        assert file.path.read_bytes() == tiny_files[file.path.suffix[1:]].read_bytes()


def test_all_that_can_be_drawn_on_a_tile_travels(cluster: str, tiny: Assignment, tiny_design: Design,
    tmp_path: Path) -> None:  # fmt: skip
    """The inverted field, a biased copy and plain rectangles without cells."""
    copies = (Copy(at_um=(-30.0, 0.0)), Copy(at_um=(30.0, 0.0), bias_nm=-4.0))
    drawn = replace(tiny_design.mask, tone="inverted", copies=copies, flat=True, formats=("oas",))
    design = replace(tiny_design, mask=drawn)
    here = mask.write(tiny.pillars, tmp_path / "here", design)[0]
    with open_executor(cluster=cluster) as executor:
        there = mask.write(tiny.pillars, tmp_path / "there", design, executor=executor)[0]
    assert here.path.read_bytes() == there.path.read_bytes()


@pytest.mark.parametrize("workers", [1, 3])
def test_any_number_of_threads_maps_the_same(
    workers: int, tiny: Assignment, profile: PhaseProfile, smooth_library: Library, tiny_design: Design
) -> None:
    with ThreadPoolExecutor(workers) as threads:
        mapped = layout.assign(profile, smooth_library, tiny_design, executor=threads)
    assert mapped.figures == tiny.figures
    assert np.array_equal(mapped.pillars.to_array(), tiny.pillars.to_array())


@pytest.mark.parametrize("engine", ["lattice", "polygons"])
def test_a_cluster_finds_the_same_violations(
    engine: str, cluster: str, tiny_files: dict[str, Path], tiny_design: Design
) -> None:
    if engine == "polygons":
        pytest.importorskip("klayout.db")
    # A gap that many neighbours lack, and an aperture whose rim lacks its pillars.
    rules, device = replace(tiny_design.rules, min_gap_nm=120.0), replace(tiny_design.device, aperture_um=40.8)
    strict = replace(tiny_design, rules=rules, device=device if engine == "lattice" else tiny_design.device)
    here, there = (drc.check(tiny_files["oas"], strict, engine=engine, work=Work(1, at)) for at in (None, cluster))
    assert there.violations == here.violations
    assert here.violations["min_gap"] > 100
    assert engine == "polygons" or here.violations["missing"] > 100
    assert there.markers == here.markers
    assert replace(there, seconds=0.0) == replace(here, seconds=0.0)


def test_the_engine_that_runs_on_one_machine_says_so(tiny_files: dict[str, Path], tiny_design: Design) -> None:
    with pytest.raises(InputError, match="runs on one machine"):
        drc.check(tiny_files["oas"], tiny_design, engine="rectangles", work=Work(cluster="tcp://127.0.0.1:1"))


def _quick(number: int) -> tuple[int, str]:
    """A number and the call that it came with."""
    return number, _this_call()


def _slow(number: int) -> str:
    """The call of a number that takes longer than calls are made to take."""
    time.sleep(0.25)
    return _this_call()


def _this_call() -> str:
    from distributed import get_worker

    return str(get_worker().get_current_task())


def _page_faults(number: int) -> int:
    """Page faults of an array of 2 MB."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    np.ones(1 << 18)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


def test_quick_items_share_calls_and_slow_ones_do_not(cluster: str) -> None:
    """Dask takes as long for a call as a tile takes; sums of a whole lens are of thousands."""
    with open_executor(cluster=cluster) as executor:
        found = list(in_order(executor, _quick, range(400)))
        slow = list(in_order(executor, _slow, range(6)))
    assert [number for number, _ in found] == list(range(400))
    assert len({call for _, call in found}) < 60
    assert len(set(slow)) == 6


@pytest.mark.skipif(sys.platform != "linux", reason="glibc's malloc")
def test_a_worker_keeps_the_memory_of_freed_arrays(cluster: str) -> None:
    """Dask has its workers give every array back; each new one then takes 500 page faults."""
    with open_executor(cluster=cluster) as executor:
        faults = list(in_order(executor, _page_faults, range(100)))
    assert np.median(faults) < 50


def _die_once(place: tuple[int, str]) -> int:
    """Kills its worker process the first time that it comes to the third tile."""
    number, mark = place
    if number == 2 and not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    with Path(mark).with_name(f"done_{number}").open("a") as log:
        log.write("x")
    return number * number


def test_a_worker_that_dies_costs_its_tile_only(cluster: str, tmp_path: Path) -> None:
    mark = str(tmp_path / "died")
    with open_executor(cluster=cluster) as executor:
        results = list(in_order(executor, _die_once, [(number, mark) for number in range(12)]))
    assert results == [number * number for number in range(12)]
    assert Path(mark).exists()
    again = sum(len((tmp_path / f"done_{number}").read_text()) for number in range(12)) - 12
    # What was finished on the dead worker and not yet handed over is made again: two calls for each of two workers are
    # in flight at a time, and the first four calls are of one tile each.
    assert again <= 4
