"""Figures of merit of libraries in closed form."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from metafab.core.conventions import covered_rad
from metafab.library import Library
from metafab.library.use.quality import coverage_rad, quality


def test_quality_of_the_closed_form(smooth_library: Library) -> None:
    """Both phases run over 1.3 turns, |t|^2 n_out / n_in = 1.5625 (1 - 0.15 w h)^2 / 1.7601."""
    figures = quality(smooth_library)
    assert figures.coverage_rad == pytest.approx(2.0 * math.pi)
    assert 0.6 < figures.mean_transmittance < 1.5625 / 1.7601
    assert figures.cd_phase_rms_rad == pytest.approx(5.0 * 2.6 * math.pi / 150.0, rel=1e-2)
    assert 0.0 < figures.phase_rms_error_rad < figures.phase_max_error_rad


def test_a_library_of_dark_sizes_covers_nothing(smooth_library: Library) -> None:
    dark = replace(smooth_library, t_xx=0.1 * smooth_library.t_xx)
    assert coverage_rad(dark) == 0.0
    assert quality(dark).torus_coverage == 0.0


def test_coverage_and_the_worst_hole_are_those_of_a_full_search(smooth_library: Library) -> None:
    """Every 8th size, some of them dark: each of the 128 x 128 pairs of phases against all sizes that pass half."""
    some = replace(
        smooth_library,
        width_nm=smooth_library.width_nm[::8],
        length_nm=smooth_library.length_nm[::8],
        t_xx=0.85 * smooth_library.t_xx[:, ::8, ::8],
        t_yy=0.85 * smooth_library.t_yy[:, ::8, ::8],
        error=np.broadcast_to(smooth_library.error, smooth_library.t_xx.shape)[:, ::8, ::8],
    )
    t = np.stack([some.t_xx[0].ravel(), some.t_yy[0].ravel()], axis=-1)
    passing = np.angle(t[np.all(np.abs(t) ** 2 / 1.7601 >= 0.5, axis=-1)])
    assert 0 < passing.shape[0] < t.shape[0]
    cells = 2.0 * math.pi * np.arange(128) / 128
    apart_x, apart_y = (np.abs(np.angle(np.exp(1j * (cells[:, None] - passing[:, k])))) for k in (0, 1))
    nearest = np.array([np.maximum(apart_x, row).min(axis=1) for row in apart_y])  # indexed [phi_y, phi_x]
    figures = quality(some)
    assert figures.torus_coverage == pytest.approx(np.mean(nearest <= 0.1), abs=1e-12)
    assert figures.worst_hole_rad == pytest.approx(nearest.max(), abs=1e-12)
    phases = figures.worst_hole_phase_y_rad, figures.worst_hole_phase_x_rad
    hole = [round(phase % (2.0 * math.pi) / (2.0 * math.pi) * 128) for phase in phases]
    assert nearest[hole[0] % 128, hole[1] % 128] == pytest.approx(nearest.max(), abs=1e-12)


def test_nine_sizes_whose_phases_go_round_reach_nearly_the_whole_turn() -> None:
    """Pillars of gallium nitride, 80 to 160 nm wide in steps of 10 nm: gaps of 1.08 rad at most, no short reach."""
    phase_rad = np.array([-1.821, -1.423, -0.898, -0.230, 0.603, 1.619, 2.699, -2.529, -1.606])
    gaps = np.diff(np.sort(phase_rad), append=np.sort(phase_rad)[0] + 2.0 * math.pi)
    open_rad = sum(gap - 2.0 * math.pi / 9.0 for gap in gaps if gap > 2.0 * math.pi / 9.0)
    assert covered_rad(phase_rad) == pytest.approx(2.0 * math.pi - 9.0 / 8.0 * open_rad)
    assert covered_rad(phase_rad) > 0.75 * 2.0 * math.pi
    # Their span and a step more; one size, or two that are alike, cover no more than their own reach.
    assert covered_rad(np.linspace(0.0, 2.0, 9)) == pytest.approx(2.0 * 9.0 / 8.0)
    assert covered_rad(np.array([1.0])) == covered_rad(np.array([1.0, 1.0])) == pytest.approx(0.2)
    assert covered_rad(np.arange(-3, 5) * math.pi / 4.0) == pytest.approx(2.0 * math.pi)
