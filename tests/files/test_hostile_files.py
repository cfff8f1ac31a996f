"""A seeded part of ``metafab benchmark files``: hostile files of every format are read or refused, never more."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from benchmarks.mask import files
from benchmarks.mask.hostile_files import Mask, mutated
from metafab.core.errors import InputError

#: Files of each format; the benchmark reads more.
COUNT = {
    "oas": 300,
    "gds": 250,
    "many.oas": 6,
    "many.gds": 7,
    "toml": 60,
    "h5": 60,
    "tif": 60,
    "png": 30,
    "npy": 30,
    "csv": 10,
}


@pytest.mark.parametrize("kind", files.FORMATS)
def test_hostile_files_are_read_or_refused(kind: str, tmp_path: Path) -> None:
    verdicts = list(files.examine(kind, range(COUNT[kind]), tmp_path))
    assert [verdict.seed for verdict in verdicts] == list(range(COUNT[kind]))
    assert [verdict for verdict in verdicts if verdict.failed] == []
    outcomes = {verdict.outcome for verdict in verdicts}
    assert "refused" in outcomes
    # Some get through, so that the code behind the first checks is reached; the table is too short for that.
    assert "read" in outcomes or kind == "csv"


def test_placed_polygons_of_many_corners_are_charged_by_corner(tmp_path: Path) -> None:
    """A file that once took 21 s: its cells hold 250 rings of 200 corners and are placed a thousand times."""
    verdicts = list(files.examine("many.gds", range(109_000_010, 109_000_011), tmp_path))
    assert [verdict.outcome for verdict in verdicts] == ["refused"]


def test_a_seed_gives_one_file() -> None:
    assert Mask(7).oasis() == Mask(7).oasis() != Mask(8).oasis()
    assert Mask(7).gdsii() == Mask(7).gdsii() != Mask(8).gdsii()
    assert mutated(b"whole file", 3) == mutated(b"whole file", 3) != b"whole file"


def test_failures_of_every_kind_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def read(path: Path) -> None:
        seed = int(path.read_bytes())
        if seed == 1:
            raise InputError.single("file", "content", "another", "this")
        if seed == 2:
            raise KeyError("lost")
        if seed == 3:
            os.kill(os.getpid(), signal.SIGKILL)
        if seed == 4:
            bytearray(1 << 31)
        if seed == 5:
            end = time.process_time() + 0.3
            while time.process_time() < end:
                pass

    found = list(files.judged((read,), lambda seed: b"%d" % seed, "txt", range(7), tmp_path, limit_s=0.2))
    assert [verdict.outcome.split(":")[0] for verdict in found] == [
        "read", "refused", "KeyError", "the process ended with -9", "MemoryError", "0.3 s", "read",
    ]  # fmt: skip
    assert [verdict.failed for verdict in found] == [False, False, True, True, True, True, False]
