"""Interpreters with Meep, without it, and with a package that only has its name."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from metafab.cell.meep import finding
from metafab.core.errors import MissingToolError


def _interpreter(tmp_path: Path, meep: str | None) -> Path:
    """A virtual environment in miniature: our Python, with a package of that name, or with none."""
    script = tmp_path / "python"
    lines = ["#!/bin/sh"]
    if meep is None:
        lines.append(f'exec "{sys.executable}" -S "$@"')
    else:
        package = tmp_path / "site"
        package.mkdir()
        (package / "meep.py").write_text(meep)
        # -I would hide PYTHONPATH, which is the point of it: put the package where site.py finds it.
        shim = f"import sys, runpy; sys.path.insert(0, {str(package)!r}); sys.argv = sys.argv[1:]; "
        shim += "runpy.run_path(sys.argv[0], run_name='__main__')"
        lines.append(f'shift\nexec "{sys.executable}" -c "{shim}" "$@"')
    script.write_text("\n".join(lines) + "\n")
    script.chmod(0o755)
    return script


def test_an_impostor_named_meep_is_not_taken(tmp_path: Path) -> None:
    impostor = _interpreter(tmp_path, "__version__ = '0.0.1'\nprint('hello from an unrelated package')\n")
    (candidate,) = finding.find(impostor)
    assert not candidate.found
    assert candidate.version == "0.0.1"
    assert "not the FDTD program" in candidate.reason
    with pytest.raises(MissingToolError, match=r"python3-meep(.|\n)*pymeep(.|\n)*another program"):
        finding.best(impostor)


def test_a_better_impostor_fails_in_vacuum(tmp_path: Path) -> None:
    names = "Simulation PML GaussianSource Medium Mirror Vector3 Source Ex verbosity"
    code = (
        f"class Thing:\n    def __init__(self, *a, **k): pass\nfor name in {names.split()!r}: globals()[name] = Thing\n"
    )
    (candidate,) = finding.find(_interpreter(tmp_path, code))
    assert not candidate.found
    assert "vacuum" in candidate.reason


def test_interpreters_without_meep_say_why(tmp_path: Path) -> None:
    (candidate,) = finding.find(_interpreter(tmp_path, None))
    assert not candidate.found
    assert "meep" in candidate.reason or "numpy" in candidate.reason
    (candidate,) = finding.find(tmp_path / "no_such_python")
    assert candidate.reason == "no such file"


def test_the_variable_comes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    named = _interpreter(tmp_path, "raise RuntimeError('broken installation')\n")
    monkeypatch.setenv(finding.VARIABLE, str(named))
    first = finding.find()[0]
    assert first.interpreter == named
    assert "broken installation" in first.reason


def test_the_environment_of_a_worker_is_clean(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", "/somewhere")
    monkeypatch.setenv("VIRTUAL_ENV", "/elsewhere")
    environment = finding.clean_environment()
    assert environment["OMP_NUM_THREADS"] == "1"
    assert not {"PYTHONPATH", "VIRTUAL_ENV", "PYTHONHOME"} & set(environment)
