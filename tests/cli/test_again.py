"""A run keeps its answer unless what it rests on changed while it worked."""

from __future__ import annotations

import importlib
import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from metafab.cli.again import answer_again
from metafab.cli.commands.run import run_command
from tests.closed_form_run import run_summary
from tests.main_job import ROOT, SMALL


def _edit_design(design: Path, folder: Path, began_ns: int) -> None:
    design.write_text(design.read_text().replace("aperture_um", "aperture_um ", 1))


def _leave_coupling(design: Path, folder: Path, began_ns: int) -> None:
    (folder / "coupling.json").write_text("{}")
    os.utime(folder / "coupling.json", ns=(began_ns, began_ns))


@pytest.mark.parametrize(
    ("meanwhile", "is_kept"), [(lambda *_: None, True), (_edit_design, False), (_leave_coupling, False)]
)
def test_what_changes_during_a_run_keeps_no_answer(
    meanwhile: Callable[[Path, Path, int], None], is_kept: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The clock steps back by ten seconds as the run begins, so that all files written later look older."""
    design, folder, began_ns = tmp_path / "lens.toml", tmp_path / "run", time.time_ns() + 10**10
    design.write_text(SMALL.read_text(encoding="utf-8").replace('"../', f'"{ROOT}/'), encoding="utf-8")

    def run(*_: Any, **__: Any) -> Any:
        folder.mkdir()
        meanwhile(design, folder, began_ns)
        return replace(run_summary(), drc=None)

    monkeypatch.setattr(importlib.import_module("metafab.run"), "run", run)
    monkeypatch.setattr(time, "time_ns", lambda: began_ns)
    run_command(design, folder)
    assert (answer_again(["run", str(design), "-o", str(folder)]) is not None) == is_kept
