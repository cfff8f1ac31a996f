"""Floors of the steps: they grow with the work that they stand for."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.pipeline import floor


def test_floors_grow_with_the_work(tmp_path: Path) -> None:
    few, many = floor.passes_s(1 << 18), floor.passes_s(1 << 26)
    assert 0.0 < few < many
    assert many == pytest.approx(16.0 * floor.passes_s(1 << 22), rel=0.8)
    assert floor.window_s(100, 64) < floor.window_s(10_000, 64)
    assert floor.transform_s(64, 64) < floor.transform_s(1024, 1024)
    small, large = (floor.written_s(tmp_path / "file", count) for count in (1 << 20, 1 << 27))
    assert small < large
    assert list(tmp_path.iterdir()) == []


def test_a_pass_of_the_floor_reads_every_byte(tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("one", "two")]
    for number, file in enumerate(files, start=1):
        file.write_bytes(bytes(number << 24))
    assert floor.read_s(files[:1]) < floor.read_s(files)
