"""A picture that the lattice cannot paint is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from metafab.core.errors import InputError
from metafab.spec import load_design, write_new
from metafab.steps import preflight


def test_a_picture_that_is_too_wide_is_refused_before_any_work(tmp_path: Path) -> None:
    file, _, picture = write_new("mine", "hologram", tmp_path)
    text = file.read_text(encoding="utf-8")
    file.write_text(text.replace("width_um = 100.0", "width_um = 1e6"), encoding="utf-8")
    with pytest.raises(InputError, match=r"`phase\[1\]\.width_um`: expected at most \d+.* um") as refusal:
        preflight(load_design(file))
    most_um = refusal.value.faults[0].expected.split()[2]
    file.write_text(text.replace("width_um = 100.0", f"width_um = {0.9999 * float(most_um):f}"), encoding="utf-8")
    preflight(load_design(file))
    picture.unlink()
    with pytest.raises(InputError, match=r"`phase\[1\]\.file`: .*no file at that path"):
        preflight(load_design(file))
