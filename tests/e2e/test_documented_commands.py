"""README and documentation, word for word: their commands run, and their Python runs, in a clone of their own."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import MainJob
from tests.main_job import ROOT, metafab

PAGES = [ROOT / "README.md", *sorted(p for p in (ROOT / "docs").rglob("*.md") if "_build" not in p.parts)]

#: What no test follows, and why; a command not named here is run.
NOT_RUN = {
    ".ci/setup": "sets up the very environment that runs the tests; CI begins with it",
    ".ci/run": "runs the tests, this one among them",
    "pip install": "fetches packages",
    "python3 -m venv": "is there to fetch packages",
    "benchmark": "measures for minutes; tests/cli/test_benchmark.py runs a room",
    "sphinx-build": "builds the documentation; tests/e2e/test_report_docs.py does",
    "dask": "starts a cluster; tests/files/library/sweep/test_build.py has one",
    "--cluster": "needs the cluster",
}

#: Keys of samples that are smaller in the clone, since they take most of the run: a library of 9 sizes in place of 56,
#: PSFs at 9 field points in place of 35, and half of the frame. No test reads figures of these runs.
SMALLER = {
    "unitcell_lib/tio2_hexagonal_660nm.toml": (("[100.0, 240.0]", "[100.0, 220.0]"), ("= 20.0", "= 60.0")),
    "layouts/helix_5cm.toml": (("points = [7, 5]", "points = [3, 3]"), ("px = [480, 960]", "px = [240, 960]")),
}

#: Pages whose Python no test follows, and why.
PYTHON_NOT_RUN = {
    "new-process": "asks a library over wavelength and bias: minutes; tests/unit/library/test_axes.py has one",
    "cluster": "needs Slurm or Kubernetes",
}


def blocks(page: Path, language: str) -> list[str]:
    """The fenced blocks of a language, in order."""
    text = page.read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def commands(page: Path) -> list[str]:
    """The command lines of a page's console blocks; ``&&`` joins two."""
    lines = [line[2:] for block in blocks(page, "console") for line in block.splitlines() if line.startswith("$ ")]
    return [part.strip() for line in lines for part in line.removesuffix("&").split("&&")]


def why_not(command: str) -> str | None:
    """Why a command is not run, None where it is."""
    return next((reason for part, reason in NOT_RUN.items() if part in command), None)


@pytest.fixture(scope="module")
def clone(main_job: MainJob, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clone as the pages expect it, in which the small lens has been made."""
    folder = tmp_path_factory.mktemp("clone")
    shutil.copytree(ROOT / "layouts", folder / "layouts")
    # Copies: a command of a page may change what it names. Built libraries keep their times, by which they are current.
    shutil.copytree(ROOT / "unitcell_lib", folder / "unitcell_lib")
    shutil.copytree(main_job.folder, folder / "runs" / "helix_small")
    for name, changes in SMALLER.items():
        text = (folder / name).read_text(encoding="utf-8")
        for old, new in changes:
            assert text.count(old) == 1, f"{name}: {old}"
            text = text.replace(old, new)
        (folder / name).write_text(text, encoding="utf-8")
    return folder


FOLLOWED = [page for page in PAGES if any(why_not(command) is None for command in commands(page))]


@pytest.mark.slow
@pytest.mark.parametrize("page", FOLLOWED, ids=lambda page: page.stem)
def test_commands_do_what_the_page_says(page: Path, clone: Path) -> None:
    for command in commands(page):
        if why_not(command) is not None:
            continue
        words = shlex.split(command)
        if Path(words[0]).name == "metafab":
            answer = metafab(*words[1:], cwd=clone)
            assert answer.code == 0, f"{command}\n{answer.stderr}"
        else:
            subprocess.run(command, shell=True, cwd=clone, check=True, timeout=60)


def test_every_reason_not_to_run_is_needed() -> None:
    every = [command for page in PAGES for command in commands(page)]
    for part in NOT_RUN:
        assert any(part in command for command in every), f"no page says {part!r} any more"
    followed = {Path(shlex.split(command)[0]).name for command in every if why_not(command) is None}
    assert followed <= {"metafab", "sed", "cat"}


def python_pages() -> list[Path]:
    """Pages whose Python runs."""
    return [page for page in PAGES if blocks(page, "python") and page.stem not in PYTHON_NOT_RUN]


@pytest.mark.parametrize("page", python_pages(), ids=lambda page: page.stem)
def test_python_runs(page: Path, clone: Path) -> None:
    """The blocks of a page in order, in one interpreter, as a reader would paste them."""
    code = "\n".join(blocks(page, "python"))
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], cwd=clone, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
