"""What a design alone tells is told before the library is built."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.main_job import SMALL, UNIT_CELL, metafab


@pytest.mark.parametrize("options", [[], ["--plan"]], ids=["write", "plan"])
def test_layout_refuses_a_write_field_before_it_builds_a_library(tmp_path: Path, options: list[str]) -> None:
    cell = tmp_path / "cell.toml"
    cell.write_bytes(UNIT_CELL.read_bytes())
    design = tmp_path / "design.toml"
    text = SMALL.read_text(encoding="utf-8").replace("../unitcell_lib/sos_800nm.toml", "cell.toml")
    design.write_text(text.replace("write_field_um = 499.8", "write_field_um = 500.0"), encoding="utf-8")
    answer = metafab("layout", design, "-o", tmp_path / "out", *options, timeout_s=60.0)
    assert (answer.code, answer.stdout) == (2, "")
    assert "`mask.write_field_um`: expected a whole number of periods of 350 nm" in answer.stderr
    assert {path.name for path in tmp_path.iterdir()} == {"cell.toml", "design.toml"}  # no library, no folder
