"""Fixtures that several folders share."""

from __future__ import annotations

import gc
import os
import re
import threading
from collections.abc import Generator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import settings
from xdist.scheduler import LoadScopeScheduling

from metafab.library.library import Library
from metafab.spec import Design, UnitCell, load_design, load_unit_cell
from tests.main_job import SMALL, Answer, metafab

ROOT = Path(__file__).parent.parent

# Tests neither use nor leave finished FDTD runs among the user's caches.
os.environ["METAFAB_MEEP_JOBS"] = ""

# The first call of a compiled kernel takes seconds; wall clock is no property of correctness.
# In CI the same examples every time: new ones are found where people work, not while a change lands.
settings.register_profile("metafab", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("metafab")


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Leave tests that copy their process to one without other threads."""
    if item.get_closest_marker("alone") and threading.active_count() > 1:
        pytest.skip("run by tests/unit/core/parallel/test_alone.py in a process of its own")


class SharedFixtures(LoadScopeScheduling):  # type: ignore[misc]
    """Scheduler of xdist that keeps tests with a fixture in common on one worker, which then makes it once.

    By files, since the groups of ``--dist loadgroup`` do nothing with pytest 9.2 and xdist 3.8.
    """

    def _split_scope(self, nodeid: str) -> str:
        return _shared_by(nodeid.partition("::")[0]) or nodeid

    def mark_test_complete(self, node: Any, item_index: int, duration: float = 0.0) -> None:
        """As the base class, whose count at each test goes over all that a worker holds: what is done is dropped."""
        super().mark_test_complete(node, item_index, duration)
        given = self.assigned_work[node]
        scope = self._split_scope(self.registered_collections[node][item_index])
        if all(given[scope].values()):
            del given[scope]


#: Names of the fixtures that are made once for a file or a session.
_MADE_ONCE = re.compile(r'fixture\(.*scope="(?:module|session)".*\)\ndef (\w+)')


@cache
def _shared_by(path: str) -> str | None:
    """The fixture, or the file itself, whose tests stay together; None for a file without fixtures made once.

    They are its own, or those of the nearest ``conftest.py`` but this one: files of one folder may still be apart.
    """
    text = (ROOT / path).read_text(encoding="utf-8")
    if "main_job: MainJob" in text:
        return "main_job"
    folders = (ROOT / path).relative_to(ROOT / "tests").parents[:-1]
    nearest = next((file for each in folders if (file := ROOT / "tests" / each / "conftest.py").is_file()), None)
    of_folder = _MADE_ONCE.findall(nearest.read_text(encoding="utf-8")) if nearest else []
    is_shared = _MADE_ONCE.search(text) or any(re.search(rf"\b{name}: ", text) for name in of_folder)
    return path if is_shared else None


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> SharedFixtures | None:
    """Use :class:`SharedFixtures`, unless ``--dist`` names another way."""
    return SharedFixtures(config, log) if config.getoption("dist") in ("load", "loadscope") else None


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Search for garbage once after thousands of tests are collected, and leave them out of every later search."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.collect()
        gc.freeze()
        gc.set_threshold(20_000)  # As in commands.
        gc.enable()


@pytest.fixture(scope="session")
def unit_cell() -> UnitCell:
    """The paper's unit cell."""
    return load_unit_cell(ROOT / "unitcell_lib" / "sos_800nm.toml")


@pytest.fixture(scope="session")
def small_design() -> Design:
    """The small design of the main job."""
    return load_design(ROOT / "layouts" / "helix_small.toml")


@pytest.fixture(scope="session")
def smooth_library(unit_cell: UnitCell) -> Library:
    """A library in closed form, for rooms whose tests must not depend on a solver.

    Each polarisation's phase runs over 1.3 turns, mostly with its own side of the pillar; both amplitudes dip
    smoothly for large pillars.
    """
    sweep = unit_cell.sweep
    count = round((sweep.width_nm[1] - sweep.width_nm[0]) / sweep.size_grid_nm) + 1
    side = np.linspace(*sweep.width_nm, count)
    own = (side - side[0]) / (side[-1] - side[0])
    width, length = own[None, :], own[:, None]
    phase_x = 2.6 * np.pi * (0.8 * width + 0.2 * length)
    phase_y = 2.6 * np.pi * (0.8 * length + 0.2 * width)
    amplitude = 1.25 * (1.0 - 0.15 * width * length)
    t_xx = (amplitude * np.exp(1j * phase_x))[None]
    t_yy = (amplitude * np.exp(1j * phase_y))[None]
    r = np.full_like(t_xx, 0.1)
    wavelength = np.array([unit_cell.illumination.wavelength_nm])
    return Library(
        unit_cell, wavelength, side, side.copy(), t_xx, t_yy, r, r.copy(), np.full(t_xx.shape, 1e-3), "closed form"
    )


@dataclass(frozen=True)
class MainJob:
    """The finished run of the small design."""

    folder: Path
    answer: Answer


@pytest.fixture(scope="session")
def main_job(tmp_path_factory: pytest.TempPathFactory) -> MainJob:
    """``metafab run layouts/helix_small.toml --json``, once."""
    folder = tmp_path_factory.mktemp("runs") / "helix_small"
    answer = metafab("run", SMALL, "-o", folder, "--json", fresh=True)
    assert answer.code == 0, answer.stderr
    return MainJob(folder, answer)
