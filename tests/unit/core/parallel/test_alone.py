"""Tests that copy their process, in one without other threads: those of earlier tests would have them skipped."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).parents[3]


def test_those_that_copy_their_process_pass() -> None:
    marked = [path for path in sorted(TESTS.rglob("test_*.py")) if "@pytest.mark.alone" in path.read_text("utf-8")]
    marked.remove(Path(__file__))
    command = [sys.executable, "-m", "pytest", "-q", "-m", "alone", "-p", "no:cacheprovider", *map(str, marked)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    assert re.search(r"\d+ passed, \d+ deselected", run.stdout), run.stdout  # none is skipped
