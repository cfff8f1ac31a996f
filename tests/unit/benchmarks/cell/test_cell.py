"""Peers of the unit-cell benchmark: the pillar that they are given, and what becomes of their answers."""

from __future__ import annotations

import json
import runpy
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from metafab.cell import PillarCell
from metafab.cell.rcwa import zero_order
from tests.main_job import ROOT

CELL_FILE, PEERS_FILE = ROOT / "benchmarks" / "cell" / "cell.py", ROOT / "benchmarks" / "cell" / "cell_peers.py"
FILM = PillarCell(
    period_nm=(350.0, 350.0),
    width_nm=350.0,
    length_nm=350.0,
    height_nm=600.0,
    n_pillar=3.6941 + 0.0065j,
    n_substrate=(1.7601, 1.7601),
    n_ambient=1.25,
    wavelength_nm=800.0,
)


@pytest.fixture(scope="module")
def benchmark() -> dict[str, Any]:
    return runpy.run_path(str(CELL_FILE))


@pytest.fixture(scope="module")
def pillar() -> Any:
    kind = runpy.run_path(str(PEERS_FILE))["Pillar"]
    return kind(350.0, 120.0, 181.0, 600.0, 800.0, (3.6941, 0.0065), 1.7601, 1.0)


def test_coefficients_are_those_of_the_raster(pillar: Any) -> None:
    """A raster of N pixels adds the orders m + k N to order m: 3 (pi m / N)^2 / 6 of 12 at the most, 5e-3 at m = 5."""
    spectrum = np.fft.fft2(np.fft.ifftshift(pillar.raster())) / 700**2
    m, n = np.meshgrid(np.arange(-5, 6), np.arange(-5, 6), indexing="ij")
    half_pixel = np.exp(-1j * np.pi * (m + n) / 700.0)
    np.testing.assert_allclose(spectrum[m, n] * half_pixel, pillar.coefficient(m, n), atol=5e-3)


def test_the_raster_has_the_pillars_exact_area_and_axes(pillar: Any) -> None:
    inside = pillar.raster() != 1.0
    assert inside.sum() * 0.25 == 120.0 * 181.0
    assert inside.any(axis=1).sum() * 0.5 == 120.0  # x is the first index


def test_the_field_is_normal_to_every_wall(pillar: Any) -> None:
    inside = (pillar.raster() != 1.0).astype(int)
    x, y = pillar.normal_field()
    np.testing.assert_array_equal(np.abs(x) ** 2 + np.abs(y) ** 2, 1.0)
    across_x, across_y = (np.diff(inside, axis=axis) != 0 for axis in (0, 1))
    # Two pixels next to a corner belong to either wall.
    assert (x[:-1][across_x] != 0).sum() >= across_x.sum() - 4
    assert (y[:, :-1][across_y] != 0).sum() >= across_y.sum() - 4


def test_a_peer_that_fails_says_why(benchmark: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("METAFAB_PEERS_PYTHON", sys.executable)
    answers, complaint = benchmark["ask_peer"]("nobody", [FILM], 1.0)
    assert answers == []
    assert complaint == "KeyError: 'nobody'"


def test_missing_peers_are_rows_that_say_so(
    benchmark: dict[str, Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("METAFAB_PEERS_PYTHON", _interpreter(tmp_path, "echo no such package >&2; exit 1"))
    table = benchmark["_peers"](True)
    assert {row["name"]: row["skipped"] for row in table[:-1]} == dict.fromkeys(
        ("fmmax", "meent", "grcwa", "torcwa", "inkstone", "nannos", "torchrdit"), "no such package"
    )
    assert all(row["error"] is row["seconds"] is None for row in table)
    assert table[-1]["name"] == "S4"


def test_answers_become_errors_and_ratios(
    benchmark: dict[str, Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A peer that answers 0.75 times the truth in 100 s errs by a quarter of the largest |t|."""
    cells = [benchmark["paper_cell"](*size_nm) for size_nm in benchmark["PEER_NM"]]
    truth = np.array([np.diag(zero_order(cell, 12).t) for cell in cells])
    t = np.stack([truth.real, truth.imag], axis=-1) * 0.75
    answer = {"orders": 49, "t": t.tolist(), "seconds": [90.0, 110.0], "peak_rss_mb": 7.0}
    monkeypatch.setenv("METAFAB_PEERS_PYTHON", _interpreter(tmp_path, f"echo '{json.dumps(answer)}'"))
    row = next(row for row in benchmark["_peers"](True) if row["series"] == "meent")
    assert row["error"] == pytest.approx(0.25 * np.abs(truth).max(), rel=1e-9)
    assert (row["seconds"], row["peak_rss_mb"], row["name"]) == (100.0, 7.0, "meent, 49 orders, t alone")
    # Ours takes milliseconds to an error of a quarter; certified answers take longer than a single truncation.
    assert row["ours_faster"] > row["ours_certified_faster"] > 100.0


@pytest.mark.parametrize("name", ["fmmax", "meent", "grcwa", "torcwa", "inkstone", "nannos", "torchrdit"])
def test_installed_peers_share_our_conventions(benchmark: dict[str, Any], name: str) -> None:
    """A film that fills the cell: every code is exact, and ours equals the closed form."""
    answers, complaint = benchmark["ask_peer"](name, [FILM], 0.0)
    if "No module named" in complaint:
        pytest.skip(f"{name}: {complaint}")
    assert answers, complaint
    t = np.array(answers[0]["t"])[0]
    # torcwa shifts its wave numbers by some 1e-9 against singular matrices.
    np.testing.assert_allclose(t[:, 0] + 1j * t[:, 1], np.diag(zero_order(FILM, 2).t), atol=1e-7)


def _interpreter(folder: Path, script: str) -> str:
    path = folder / "python"
    path.write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
    path.chmod(0o755)
    return str(path)
