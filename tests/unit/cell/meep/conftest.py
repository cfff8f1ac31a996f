"""Commands of fake workers for all tests of this folder."""

from __future__ import annotations

import sys
import textwrap
from pathlib import Path

import pytest

from tests.fake_worker import PRELUDE, Fake


@pytest.fixture
def fake(tmp_path: Path) -> Fake:
    """A command that starts a fake worker with this behaviour, indented by four."""

    def write(behaviour: str) -> list[str]:
        script = tmp_path / f"fake_{len(list(tmp_path.iterdir()))}.py"
        script.write_text(PRELUDE + textwrap.indent(textwrap.dedent(behaviour), "    "))
        return [sys.executable, "-I", str(script)]

    return write
