"""The built wheel in an environment without the source tree: every kind of device is made, and one is run."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from metafab.spec import kinds

ROOT = Path(__file__).parents[2]

#: The installed command, called for each kind by one process, which imports once.
NEW_OF_EACH = """
import sys
from metafab.cli.entry import program
folder, *kinds = sys.argv[1:]
for kind in kinds:
    program(["new"])(["new", kind, "--kind", kind, "-o", f"{folder}/{kind}", "--json"], standalone_mode=False)
"""


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`metafab` installed from a wheel; the packages that it needs are those of this environment."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    source.mkdir()
    for name in ("pyproject.toml", "README.md"):
        shutil.copy(ROOT / name, source)
    shutil.copytree(ROOT / "metafab", source / "metafab", ignore=shutil.ignore_patterns("__pycache__"))
    (source / "docs").mkdir()
    shutil.copy(ROOT / "docs" / "LICENSE", source / "docs")
    build = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", str(folder)]
    subprocess.run([*build, str(source)], check=True, capture_output=True)
    environment = folder / "clean"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(environment)], check=True)
    packages = next((environment / "lib").glob("python*/site-packages"))
    install = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-index", "--no-compile"]
    wheel = next(folder.glob("metafab-*.whl"))
    python = str(environment / "bin" / "python")
    subprocess.run([*install[:3], "--python", python, *install[3:], str(wheel)], check=True, capture_output=True)
    # A path file adds this environment's packages, but not its editable metafab: that hangs on path files of its own.
    (packages / "needed.pth").write_text(sysconfig.get_path("purelib"), encoding="utf-8")
    _copy_compiled(ROOT / "metafab", packages / "metafab")
    shutil.rmtree(source)
    return environment / "bin" / "metafab"


def _copy_compiled(source: Path, installed: Path) -> None:
    """Give the installed files the compiled code of equal ones; Python and numba know a file by its time and size."""
    for file in installed.rglob("*.py"):
        equal = source / file.relative_to(installed)
        assert file.read_bytes() == equal.read_bytes()
        for code in (equal.parent / "__pycache__").glob(f"{file.stem}.*"):
            (file.parent / "__pycache__").mkdir(exist_ok=True)
            shutil.copy(code, file.parent / "__pycache__")
        shutil.copystat(equal, file)


def _output(*arguments: str | Path, folder: Path) -> str:
    # The source tree may be on the path of this process; the wheel must do without.
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    command = [*map(str, arguments)]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_a_wheel_makes_every_kind_of_device_in_an_empty_folder_and_runs_one(program: Path, tmp_path: Path) -> None:
    assert _output(program, "--version", folder=tmp_path).startswith("metafab ")
    python = program.with_name("python")
    place = Path(_output(python, "-c", "import metafab; print(metafab.__file__)", folder=tmp_path))
    assert program.parent.parent in place.parents
    assert set(json.loads(_output(program, "new", "--json", folder=tmp_path))) == set(kinds())
    made = _output(python, "-c", NEW_OF_EACH, tmp_path, *kinds(), folder=tmp_path).splitlines()
    assert len(made) == len(kinds())
    assert all((tmp_path / path).is_file() for line in made for path in json.loads(line)["files"])
    design = tmp_path / "vortex_lens" / "vortex_lens.toml"
    summary = json.loads(_output(program, "run", design, "--json", folder=tmp_path))
    assert (tmp_path / "runs" / "vortex_lens" / "report.html").is_file()
    assert summary["layout"]["pillars"] > 1000
