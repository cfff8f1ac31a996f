"""Floors of jobs and steps: they grow with the work that they stand for."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.cell import algebra
from benchmarks.cell.cell import paper_cell
from benchmarks.pipeline import least_work
from metafab.cell import CellNumerics, solve


def test_floors_grow_with_the_work(tmp_path: Path) -> None:
    few, many = least_work.passes_s(1 << 18), least_work.passes_s(1 << 26)
    assert 0.0 < few < many
    assert least_work.window_s(100, 64) < least_work.window_s(10_000, 64)
    assert least_work.transform_s(64, 64) < least_work.transform_s(1024, 1024)
    small, large = (least_work.written_s(tmp_path / "file", count) for count in (1 << 20, 1 << 27))
    assert small < large
    assert list(tmp_path.iterdir()) == []


def test_a_pass_of_the_floor_reads_every_byte(tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("one", "two")]
    for number, file in enumerate(files, start=1):
        file.write_bytes(bytes(number << 24))
    assert least_work.read_s(files[:1]) < least_work.read_s(files)


def test_the_floor_of_a_pillar_counts_the_products_of_all_truncations(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(algebra, "_doubled_s", lambda orders, doublings: float(orders))
    loose, tight = (solve(paper_cell(120.0, 180.0), CellNumerics(target_error=target)) for target in (1e-2, 1e-4))
    assert 0.0 < algebra.algebra_s([loose]) < algebra.algebra_s([tight])
    assert algebra.algebra_s([loose, tight]) == algebra.algebra_s([loose]) + algebra.algebra_s([tight])
