"""Calls the command line as a user does, and runs the small main job once for all tests that look at it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.warm_commands import warm_commands

ROOT = Path(__file__).parents[1]
SMALL = ROOT / "layouts" / "helix_small.toml"
UNIT_CELL = ROOT / "unitcell_lib" / "sos_800nm.toml"


@dataclass(frozen=True)
class Answer:
    """What a command left behind."""

    code: int
    stdout: str
    stderr: str

    @property
    def json(self) -> dict[str, Any]:
        """Standard output as the one JSON object that it must be."""
        return dict(json.loads(self.stdout))


def metafab(*arguments: str | Path, cwd: Path | None = None, timeout_s: float = 600.0, fresh: bool = False) -> Answer:
    """Run ``metafab ARGUMENTS`` in a process of its own; ``fresh`` in one that imports for itself, as a user's does."""
    if sys.platform == "linux" and not fresh:
        return Answer(*warm_commands()([*map(str, arguments)], cwd, timeout_s))
    command = [sys.executable, "-m", "metafab.cli", *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=cwd, env=environment, timeout=timeout_s, check=False
    )
    return Answer(done.returncode, done.stdout, done.stderr)
