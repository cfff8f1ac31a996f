"""Null energy of twins, and the segments across outlines."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.segmentation.fit import (
    Misfit,
    TwinEnergies,
    across_outlines,
    fitting_segments,
    foreign_light,
    misfit_at,
)
from metafab.decode.segmentation.planes import Plane
from metafab.decode.segmentation.segments import Regions, SegmentDepth


@pytest.mark.parametrize("contrast", [0.4, 1.0, 2.5, -1.0])
def test_noise_is_left_of_equal_twins_whatever_their_contrast(contrast: float) -> None:
    rng = np.random.default_rng(1)
    texture, noise = rng.normal(0.0, 20.0, 20000), rng.normal(0.0, 1.0, (2, 20000))
    a, b = contrast * texture + noise[0], texture + noise[1]
    of = TwinEnergies(np.array([np.mean(a * b), np.mean(a * a), np.mean(b * b)]))
    # The mean of 20000 squares of variance 2 is known to 1 %.
    assert float(of.null_energy) == pytest.approx(1.0, abs=0.04)
    assert float(of.energy) == pytest.approx(400.0 * (1.0 + contrast**2), rel=0.05)
    other = rng.normal(0.0, 20.0, 20000)
    unlike = TwinEnergies(np.array([np.mean(a * other), np.mean(a * a), np.mean(other * other)]))
    assert float(unlike.null_energy) > 50.0


def test_the_segment_across_the_nearest_outline() -> None:
    label = np.ones((6, 12), dtype=np.int32)
    label[:, 5:9], label[:, 9:] = 2, 3
    across, away = across_outlines(label)
    assert across[0].tolist() == [2, 2, 2, 2, 2, 1, 1, 3, 3, 2, 2, 2]
    assert away[0].tolist() == [4, 3, 2, 1, 0, 0, 1, 1, 0, 0, 1, 2]


def test_an_outline_between_depths_that_are_one_within_5_percent_does_not_count() -> None:
    label = np.ones((6, 12), dtype=np.int32)
    label[:, 5:9], label[:, 9:] = 2, 3
    across, away = across_outlines(label, np.array([np.nan, 2.0, 2.02, 3.0])[label])
    assert across[0].tolist() == [3] * 9 + [2] * 3
    assert away[0].tolist() == [8, 7, 6, 5, 4, 3, 2, 1, 0, 0, 1, 2]
    # A tilted surface is its own on either side of a place whose depth is another.
    tilted = np.where(label == 3, 9.0, np.linspace(1.0, 3.0, 12))
    across, _ = across_outlines(np.where(label == 3, 3, 1).astype(np.int32), tilted)
    assert across[0].tolist() == [3] * 9 + [1] * 3


def test_darkness_is_no_outline() -> None:
    label = np.zeros((6, 12), dtype=np.int32)
    label[:, 5:9] = 1
    across, away = across_outlines(label)
    assert not across.any() and np.isinf(away).all()


def test_a_wrong_depth_is_not_excused_by_the_error_of_the_calibration() -> None:
    """Twins correlate to 0.9 at the true vergence of 2 / m, and to 0.5 one per metre away."""
    shape, nodes = (20, 20), np.linspace(1.0, 4.0, 13)
    rho = np.broadcast_to((0.9 - 0.4 * (nodes - 2.0) ** 2)[:, None, None], (13, *shape))
    volume = CostVolume(nodes, np.stack([rho, np.ones_like(rho), np.ones_like(rho)]).astype(np.float32), 0.5, 1.0)
    prepared: Any = SimpleNamespace(downsampling=SimpleNamespace(step=3), variance=np.full((2, *shape), 0.05))
    inside = np.ones(shape, dtype=np.int32)
    own = misfit_at(prepared, volume, np.full(shape, 2.0), inside)
    assert own.model_error == pytest.approx((0.1 / 0.05 - 1.0) / (2.0 / 0.05 - 2.0), rel=1e-3)
    assert own.over_noise == pytest.approx(1.0, rel=1e-3)
    other = misfit_at(prepared, volume, np.full(shape, 3.0), inside, own.model_error)
    assert other.over_noise == pytest.approx(0.5 / 0.05 / 2.0, rel=1e-2)
    assert misfit_at(prepared, volume, np.full(shape, 3.0), inside).over_noise == pytest.approx(1.0, rel=1e-2)


def test_pixels_go_to_a_connected_segment_that_they_fit() -> None:
    label = np.ones((20, 60), dtype=np.int32)
    label[:, 30:] = 2
    wedge, island, unlike = (slice(5, 12), slice(22, 30)), (slice(5, 9), slice(12, 16)), (slice(15, 18), slice(25, 30))
    over = np.ones(label.shape, dtype=np.float32)
    for part in (wedge, island, unlike):
        over[part] = 20.0
    share = np.full(label.shape, 0.2, dtype=np.float32)

    def misfit_of(number: int) -> Misfit:
        values = np.full(label.shape, 12.0, dtype=np.float32)
        values[wedge] = values[island] = 1.5
        return Misfit(values, share, 0.01)

    own = Misfit(over, share, 0.01)
    spoiled = np.zeros(label.shape, dtype=bool)
    moved, fits = fitting_segments(label, spoiled, own, misfit_of, 40.0)
    expected = label.copy()
    expected[wedge] = 2
    np.testing.assert_array_equal(moved, expected)
    np.testing.assert_array_equal(fits.over_noise, np.where(moved == label, over, np.float32(1.5)))
    np.testing.assert_array_equal(fitting_segments(label, spoiled, own, misfit_of, 3.0)[0][5:12, 22:27], 1)
    np.testing.assert_array_equal(fitting_segments(label, ~spoiled, own, misfit_of, 40.0)[0], label)
    none = fitting_segments(label, spoiled, own, misfit_of, 40.0, lambda to: np.zeros(to.shape, dtype=bool))[0]
    np.testing.assert_array_equal(none, label)  # no move explains the frame better


def test_only_surfaces_wider_than_a_window_have_outlines_that_excuse_light() -> None:
    """Light of another depth beside a narrow bar stands in the wall; that beside a wide object is the object's."""
    shape = (96, 120)
    label = np.ones(shape, dtype=np.int32)
    label[:, 20:24], label[:, 80:] = 2, 3
    depths = tuple(SegmentDepth(one, 1e-3, 0.9, 1.0, Plane(one)) for one in (1.7, 3.0, 3.4))
    misfit = Misfit(np.full(shape, 20.0, dtype=np.float32), np.full(shape, 0.2, dtype=np.float32), 0.01)
    foreign = foreign_light(Regions(3, depths, label, label, label), misfit, 3)
    assert foreign[:, :20].all() and foreign[:, 24:70].all()
    assert not foreign[:, 20:24].any() and not foreign[:, 75:85].any()
    assert foreign[:, 90:].all()
