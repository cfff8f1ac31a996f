"""``metafab stokes`` refuses what it cannot do by name and with exit code 2, before any work."""

from __future__ import annotations

from pathlib import Path

from tests.main_job import ROOT, metafab

DESIGN = ROOT / "layouts" / "stokes_small.toml"


def test_keys_that_turned_pillars_do_not_have_are_named(tmp_path: Path) -> None:
    text = DESIGN.read_text(encoding="utf-8")
    text = text.replace("../unitcell_lib", str(ROOT / "unitcell_lib"))
    text = text.replace("datatype = 0", 'datatype = 0\ntone = "inverted"')
    text = text.replace("[rules]", '[rules]\ngap_rule = "pairs"')
    path = tmp_path / "design.toml"
    path.write_text(text, encoding="utf-8")
    answer = metafab("stokes", path, "-o", tmp_path / "run", "--json")
    assert answer.code == 2
    assert answer.stdout == ""
    assert "`rules.gap_rule`: not available with turned pillars" in answer.stderr
    assert "`mask.tone`: not available with turned pillars" in answer.stderr
    assert not (tmp_path / "run").exists()


def test_angles_that_leave_out_the_diagonals_are_refused(tmp_path: Path) -> None:
    answer = metafab("stokes", DESIGN, "-o", tmp_path / "run", "--angles", "6")
    assert answer.code == 2
    assert "--angles" in answer.stderr
