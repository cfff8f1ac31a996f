"""Peers of the PSF benchmark: the light that they are given, and what becomes of their answers."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.optics.psf_comparison import JUDGED_STEP, PeerLens, ask_peer, peer_row, peer_rows, time_ratios
from benchmarks.optics.psf_peers import Cost, Lens, about_axis, of_either, with_window

APERTURE_UM = 100.0


@pytest.fixture(scope="module")
def peer_lens(tmp_path_factory: pytest.TempPathFactory) -> PeerLens:
    return PeerLens(APERTURE_UM, tmp_path_factory.mktemp("lens"))


@pytest.fixture(scope="module")
def lens(peer_lens: PeerLens) -> Lens:
    return Lens(**{**peer_lens.job, "field": np.load(peer_lens.job["field"])})


def _difference(found: Any, truth: Any, step: int) -> float:
    image = (np.abs(found) ** 2)[::step, ::step]
    scale = np.vdot(image, truth) / np.vdot(image, image)
    return float(np.linalg.norm(scale * image - truth) / np.linalg.norm(truth))


def test_the_field_given_makes_the_window_by_rayleigh_and_sommerfeld(peer_lens: PeerLens, lens: Lens) -> None:
    """A Fourier convolution with the exact kernel, plain NumPy, on the smallest grid: the light is single precision.

    The direct sum goes from the pillars to the same points, so place and scale of the window are checked with it.
    """
    side, reach = lens.field.shape[0], lens.reach_sites
    count = side + reach - 1
    row, column = ((first - (side - 1) + np.arange(count)) * lens.pitch_um for first in lens.first)
    square = column[None, :] ** 2 + row[:, None] ** 2 + lens.distance_um**2
    kernel = np.exp(1j * lens.wavenumber * np.sqrt(square)) / square * (1.0 / np.sqrt(square) - 1j * lens.wavenumber)
    whole = np.fft.ifft2(np.fft.fft2(lens.padded(count)) * np.fft.fft2(kernel))[side - 1 :, side - 1 :]
    found = whole[:: lens.stride, :: lens.stride]
    assert found.shape == (lens.window_px, lens.window_px)
    assert _difference(found, peer_lens.truth(carrier=False), JUDGED_STEP) < 1e-5


def test_without_the_path_a_plain_transform_makes_the_stretched_window(peer_lens: PeerLens, lens: Lens) -> None:
    """The carrier's field by sums of plane waves; what the linear term leaves is a per cent for so short a lens."""
    points = (np.arange(lens.window_px) - lens.window_px // 2) * lens.pixel_um
    waves = np.exp(-1j * lens.wavenumber / lens.focal_um * np.outer(points, lens.sites_um))
    found = waves @ lens.carried @ waves.T
    assert _difference(found, peer_lens.truth(carrier=True), JUDGED_STEP) < 0.02
    assert _difference(found[:, ::-1], peer_lens.truth(carrier=True), JUDGED_STEP) > 0.1


def test_light_is_read_where_a_periodic_grid_wraps_it(lens: Lens) -> None:
    rows, columns = (first + lens.stride * np.arange(lens.window_px) for first in lens.first)
    assert columns[0] < 0  # x polarised light goes to the left of the lens
    count = lens.field.shape[0] + lens.reach_sites + 1
    grid = np.arange(count**2).reshape(count, count)
    expected = (rows[:, None] % count) * count + columns[None, :] % count
    np.testing.assert_array_equal(lens.read(grid), expected)


def test_grids_hold_lens_and_window(lens: Lens) -> None:
    side, (row, column), reach = lens.field.shape[0], lens.first, lens.reach_sites
    margin = (about_axis(lens) - side) // 2
    assert min(row, column) + margin >= 0
    assert max(row, column) + reach <= side + margin
    assert min(row, column) + margin == 0 or max(row, column) + reach == side + margin
    assert with_window(lens) >= side + reach
    assert of_either(lens) >= max(side, reach)


def test_costs_grow_as_fourier_transforms_do() -> None:
    cost = Cost(2.0, 100.0).scaled(2**20, 2**24)
    assert cost.seconds == pytest.approx(2.0 * 16 * 24 / 20)
    assert cost.peak_rss_mb == pytest.approx(1600.0)


def test_answers_become_errors_and_ratios(peer_lens: PeerLens, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A peer that paints the truth with 3 % of a checkerboard, in 50 s for a lens and 400 s for the next one."""
    truth = peer_lens.truth(carrier=False)
    error = 0.03 * np.linalg.norm(truth) / math.sqrt(truth.size) * (-1.0) ** np.add.outer(*2 * [np.arange(11)])
    error -= truth * np.vdot(error, truth) / np.vdot(truth, truth)
    image = np.zeros((64, 64))
    image[::6, ::6] = 7.0 * (truth + error)
    answer = {"aperture_um": APERTURE_UM, "seconds": 50.0, "carrier_s": 1.0, "peak_rss_mb": 9.0}
    (tmp_path / "answer").write_text(json.dumps(answer | {"irradiance": image.tolist()}) + "\n", encoding="utf-8")
    monkeypatch.setenv("METAFAB_PEERS_PYTHON", _interpreter(tmp_path, f"cat {tmp_path / 'answer'}"))
    (found,), complaint = ask_peer("prysm, carrier", [peer_lens.job], 1.0)
    row = peer_row("prysm, angular spectrum", found, [peer_lens])
    assert complaint == ""
    # The best factor leaves the sine where there was the tangent.
    tangent = np.linalg.norm(error) / np.linalg.norm(truth)
    assert row["error"] == pytest.approx(tangent / math.hypot(1.0, tangent), rel=1e-6)
    assert row["field_seconds"] == peer_lens.field_s
    ours = [
        {"error": 0.05, "seconds_window": 0.001, "seconds_pass": 0.01, "seconds_stack": 0.01},
        {"error": 0.02, "seconds_window": 0.01, "seconds_pass": 0.1, "seconds_stack": 0.2},
        {"error": 0.001, "seconds_window": 0.1, "seconds_pass": 0.1, "seconds_stack": 2.0},
    ]
    ratios = time_ratios(row, ours)
    whole = 50.0 + peer_lens.field_s
    assert ratios["ours_error"] == 0.02
    assert ratios["ours_faster_window"] == pytest.approx(50.0 / 0.01)
    assert ratios["ours_faster"] == pytest.approx(whole / 0.11)
    assert ratios["ours_faster_stack"] == pytest.approx(21 * whole / 0.3)
    # An exact peer is compared with our most exact answer.
    assert time_ratios(row | {"error": 1e-9}, ours)["ours_error"] == 0.001


def test_missing_peers_are_rows_that_say_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Both interpreters of the path are asked."""
    (tmp_path / "other").mkdir()
    first = _interpreter(tmp_path, "echo nothing >&2; exit 1")
    second = _interpreter(tmp_path / "other", "echo no such package >&2; exit 1")
    monkeypatch.setenv("METAFAB_PEERS_PYTHON", f"{first}:{second}")
    table = peer_rows([], (APERTURE_UM,), limit_s=0.0)
    assert len(table) == 9
    assert {row["skipped"] for row in table} == {"no such package"}
    assert all(row["error"] is row["seconds"] is None for row in table)


@pytest.mark.parametrize(
    ("method", "largest"),
    [
        ("prysm, angular spectrum", 0.03),
        ("prysm, carrier", 0.03),
        ("hcipy, angular spectrum", 1e-5),
        ("hcipy, carrier", 0.03),
        ("poppy, carrier", 0.03),
        ("torchoptics, direct integration", 1e-5),
        ("diffractio, Rayleigh-Sommerfeld", 1e-5),
        ("diffractio, carrier", 0.03),
        ("dflat, angular spectrum", 0.1),
    ],
)
def test_installed_peers_paint_the_window(peer_lens: PeerLens, method: str, largest: float) -> None:
    """Place, orientation and size of the window; what is exact is so to the field's single precision."""
    answers, complaint = ask_peer(method, [peer_lens.job], 0.0)
    if not answers:
        pytest.skip(f"{method}: {complaint}")
    assert peer_row(method, answers[0], [peer_lens])["error"] < largest


def _interpreter(folder: Path, script: str) -> str:
    path = folder / "python"
    path.write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
    path.chmod(0o755)
    return str(path)
