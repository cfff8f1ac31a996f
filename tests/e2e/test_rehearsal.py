"""The set-up's rehearsal: passes here, and would not where masks or depths are wrong."""

from __future__ import annotations

import subprocess
import sys

import pytest

from metafab import rehearsal
from metafab.doctor import examine
from metafab.rehearsal import Rehearsal

#: Prints the depth error of a rehearsal, and the kernels that it called from Python and that no list names.
_SCRIPT = """
import sys
from metafab.core.numeric import ahead, compiled
from metafab.rehearsal import rehearse

called = {}
compile_once = compiled._compile_once

def recorded(kernel, compile_or_load, source, arguments):
    if not compiled._held:
        called[kernel.__module__, kernel.__name__, str(arguments)] = None
    return compile_once(kernel, compile_or_load, source, arguments)

compiled._compile_once = recorded
done = rehearse()
listed = {(kernel.__module__, kernel.__name__, str(types)) for file in ahead.listed_kernels() for kernel, types in file}
print(done.passed, done.nmae, *(each for each in called if each not in listed), sep="\\n")
"""


def test_the_sample_camera_is_taken_from_unit_cell_to_depths_by_listed_kernels() -> None:
    done = subprocess.run([sys.executable, "-c", _SCRIPT], capture_output=True, text=True, check=True, timeout=900)
    passed, nmae, *unlisted = done.stdout.splitlines()
    assert passed == "True"
    assert float(nmae) > 0.0
    assert not unlisted, "add them to metafab/core/numeric/kernels.toml"


def test_wrong_depths_and_broken_rules_do_not_pass() -> None:
    assert Rehearsal(0.01, 0).passed
    assert not Rehearsal(0.01, 1).passed
    assert not Rehearsal(0.1, 0).passed
    assert not Rehearsal(float("nan"), 0).passed


@pytest.mark.parametrize("violations", [0, 1])
def test_the_doctor_tells_how_the_rehearsal_went(violations: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rehearsal, "rehearse", lambda progress: Rehearsal(0.01, violations))
    assert examine(rehearse=True).self_test["rehearsal"] is (violations == 0)
    assert "rehearsal" not in examine().self_test
