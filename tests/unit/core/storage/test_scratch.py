"""Scratch arrays on disk: their content outlives the release of their memory, and their file is gone with them."""

from __future__ import annotations

import errno
import gc
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from metafab.core.storage.scratch import release, scratch


def resident_mb() -> float:
    """Memory of this process that is in use now, mapped files included."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def links_into(folder: Path) -> int:
    """Number of open files of this process in a folder, those without a name included."""
    open_files = Path("/proc/self/fd")
    return sum(str(each.readlink()).startswith(str(folder)) for each in open_files.iterdir() if each.is_symlink())


@pytest.fixture
def on_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("metafab.core.storage.scratch.IN_MEMORY_BYTES", 0)


@pytest.mark.usefixtures("on_disk")
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
def test_released_memory_is_free_and_the_content_stays() -> None:
    array = scratch((16, 1 << 21), np.uint16)
    before = resident_mb()
    assert not array.any()
    array[:] = np.arange(16)[:, None]
    assert resident_mb() - before > 60.0
    release(array[3:5, 7:])  # of any view
    assert resident_mb() - before < 8.0
    assert np.array_equal(array[:, -1], np.arange(16))


@pytest.mark.parametrize("view", [lambda array: array, lambda array: array[1:], lambda array: array.data])
def test_an_array_in_memory_is_left_alone(view: Callable[[np.ndarray], np.ndarray]) -> None:
    array = scratch((4, 4), np.uint16)
    array[:] = 7
    release(view(array))
    assert np.all(array == 7)


@pytest.mark.usefixtures("on_disk")
@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="open files are read from /proc")
def test_the_file_vanishes_with_the_array(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    array = scratch((1 << 20,), np.uint16)
    assert links_into(tmp_path) == 1
    del array
    gc.collect()
    assert list(tmp_path.iterdir()) == []
    assert links_into(tmp_path) == 0


@pytest.mark.usefixtures("on_disk")
@pytest.mark.skipif(not hasattr(os, "posix_fallocate"), reason="space is not reserved on this system")
def test_a_full_disk_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(OSError, match="No space left") as caught:
        scratch((1 << 20,), np.uint16)
    assert caught.value.__notes__ == [f"0.0021 GB of scratch in {tmp_path}; `TMPDIR` names another folder"]
    assert list(tmp_path.iterdir()) == []
