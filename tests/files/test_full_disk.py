"""A disk that is full, and a target that cannot be written: one message, exit code 1, nothing half-written."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from metafab import library
from metafab.library import Library
from metafab.spec import write_new
from tests.main_job import ROOT

LIMIT_BYTES = 20_000

WRITERS = {
    "h5": "from metafab.core.storage import hdf5\n"
    "with hdf5.create(path, kind='k', format_version=1, inputs_sha256='') as file:\n"
    "    hdf5.put(file, 'x', np.arange(1e5), units='1', description='x', dims=('x',))",
    "json": "from metafab.core.storage.files import write_json\nwrite_json(path, list(range(20000)))",
    "png": "from metafab.report.render import save_png\nfrom metafab.report.style import panel\n"
    "figure, axes = panel()\n"
    "axes.imshow(np.random.default_rng(1).random((300, 300)))\nsave_png(figure, path)",
}


#: Python's own compiled modules would be cut at the limit, too, and the next to import them would meet halves.
ENVIRONMENT = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}


def _limited() -> None:
    """In the child, before it begins: no file may grow beyond the limit, as on a disk with so much left."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (LIMIT_BYTES, LIMIT_BYTES))


@pytest.mark.parametrize("suffix", WRITERS)
def test_an_earlier_file_outlives_a_full_disk(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"result.{suffix}"
    path.write_bytes(b"earlier")
    code = f"import numpy as np\nfrom pathlib import Path\npath = Path({str(path)!r})\n{WRITERS[suffix]}"
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT, env=ENVIRONMENT, preexec_fn=_limited, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    assert "\nOSError: [Errno 27]" in done.stderr
    assert done.stderr.strip().splitlines()[-1] == f"writing {path}"
    assert path.read_bytes() == b"earlier"
    assert [each.name for each in tmp_path.iterdir()] == [path.name]


@pytest.fixture(scope="module")
def design(tmp_path_factory: pytest.TempPathFactory, smooth_library: Library) -> Path:
    folder = tmp_path_factory.mktemp("design")
    library.save(smooth_library, folder / "built.h5")
    path = write_new("tiny", "metalens", folder, folder / "built.h5")[0]
    text = path.read_text(encoding="utf-8").replace("aperture_um = 100.0", "aperture_um = 20.0")
    path.write_text(text, encoding="utf-8")
    return path


def test_a_mask_that_does_not_fit_is_not_there(design: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "metafab.cli", "layout", str(design), "-o", str(tmp_path), "--workers", "1"],
        cwd=ROOT, env=ENVIRONMENT, preexec_fn=_limited, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("metafab: OSError: [Errno 27] File too large")
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "layout.gds").exists()
    assert list(tmp_path.glob(".*")) == []


def test_a_target_that_cannot_be_a_folder(design: Path, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file")
    done = subprocess.run(
        [sys.executable, "-m", "metafab.cli", "layout", str(design), "-o", str(tmp_path / "taken" / "out")],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (2, "")
    assert "expected a place that can be written" in done.stderr
    assert (tmp_path / "taken").read_text() == "a file"
