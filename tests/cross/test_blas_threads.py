"""Calls that users make in Python keep BLAS to one thread; the command line does so for its whole process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from metafab.camera.rendering.lens import Lens
from metafab.decode.decoder import Decoder
from metafab.library.surface import Surface
from metafab.phase.build import profile_of
from metafab.phase.studies.study import study
from metafab.run import run
from metafab.spec import Design, load_design
from metafab.steps.preflight import PREFLIGHT


class _ReachedError(Exception):
    """Ends a call once it looks at its arguments."""


class _Probe:
    """An argument that notes the threads of BLAS when it is looked at."""

    def __init__(self) -> None:
        self.threads: list[int] = []

    def __getattr__(self, name: str) -> Any:
        self.threads += [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]
        raise _ReachedError


def _with_term(probe: _Probe) -> Design:
    """A design whose phase term notes the threads: others than a design are refused before."""
    design = load_design(LAYOUTS / "helix_small.toml")
    object.__setattr__(design, "phase", (probe,))
    return design


LAYOUTS = Path(__file__).parents[2] / "layouts"
_AXIS = np.linspace(100.0, 110.0, 6)
_CALLS: dict[str, Callable[[Any], Any]] = {
    "decoder": lambda probe: Decoder.of(probe, (1, 1), (0.0, 0.0)),
    "photograph": lambda probe: Lens(probe, (probe, probe)).light(probe, probe),
    "surface of a library": lambda probe: Surface.of_model(_AXIS, _AXIS, probe, np.zeros((6, 6)), 1e-3),
    "target phases": lambda probe: profile_of(_with_term(probe)),
    "study of the phases": lambda probe: study(probe, probe),
}


def test_steps_of_a_run_have_one_thread_of_blas(tmp_path: Path) -> None:
    probe = _Probe()
    check = replace(PREFLIGHT, work=lambda job: probe.figures)
    with threadpool_limits(2, "blas"), pytest.raises(_ReachedError):
        run(load_design(LAYOUTS / "helix_small.toml"), tmp_path, check=check)
    assert set(probe.threads) == {1}


@pytest.mark.parametrize("name", _CALLS)
def test_calls_from_python_have_one_thread_of_blas(name: str) -> None:
    """On two cores that others used, two threads took ten times the processor time of one for a decoder."""
    probe = _Probe()
    with threadpool_limits(2, "blas"), pytest.raises(_ReachedError):
        _CALLS[name](probe)
    assert set(probe.threads) == {1}
