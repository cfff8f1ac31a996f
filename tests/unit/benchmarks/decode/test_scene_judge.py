"""Measures of the scene benchmark on images with errors of known size and place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.decode import scene_judge as judge
from benchmarks.decode import scene_stacks, scenes
from benchmarks.decode.scene_cases import CASES
from benchmarks.decode.scene_judge import Decoded
from benchmarks.decode.scenes import rows
from metafab import benchmark
from metafab.camera import RawFrame, Truth
from metafab.core.errors import InputError
from metafab.core.figures import SegmentFigures
from metafab.decode import Image4D

SHAPE, WALL_M, OBJECT_M = (60, 200), 0.6, 0.3
OBJECT = (slice(20, 40), slice(80, 120))


def _decoded(change: Callable[[dict[str, np.ndarray]], None] = lambda maps: None) -> Decoded:
    """A wall with one object, decoded without error except for ``change``."""
    label = np.ones(SHAPE, dtype=np.int32)
    label[OBJECT] = 2
    depth_m = np.where(label == 1, WALL_M, OBJECT_M)
    light = np.full(SHAPE, 1000.0)
    truth = Truth(depth_m, light, 0.5 * light, label)
    maps = {
        "depth_m": depth_m.copy(),
        "confidence": np.ones(SHAPE),
        "intensity_x": light.copy(),
        "intensity_y": 0.5 * light,
        "depth_pixel_m": depth_m.copy(),
    }
    change(maps)
    image = Image4D(contrast=light, segment=label, origin_um=(0.0, 0.0), pixel_um=3.45, **maps)
    # The frame's truth begins 3 columns and 2 rows within the image.
    cut = Truth(**{name: value[2:, 3:] for name, value in vars(truth).items()})
    return Decoded.of(image, RawFrame(light, 3.45, (0.0, 0.0), 2.0, cut, (3 * 3.45, 2 * 3.45)))


def test_a_perfect_image_has_no_error() -> None:
    seen = _decoded()
    assert seen.depth_m.shape == (58, 197)
    errors = (judge.all_error, judge.worst_object_error, judge.sure_and_wrong, judge.miscalibration, judge.swapped)
    assert [measure(seen) for measure in errors] == [0.0] * 5
    assert judge.wrong_side_near(seen) == judge.wrong_side_far(seen) == judge.bars_claimed(seen) == 0.0
    assert judge.found(seen) == judge.bars_found(seen) == judge.decoded_share(seen) == 1.0
    assert judge.contrast_error(seen) == pytest.approx(0.0) and judge.side_bias(seen) == 0.0


def test_a_ring_of_three_pixels_is_on_the_wrong_side() -> None:
    def ring(maps: dict[str, np.ndarray]) -> None:
        maps["depth_m"][17:43, 77:123] = OBJECT_M

    seen = _decoded(ring)
    # Of the first band, 0 to 3 px from the edge, the ring holds the straight parts and all but the corners' outside.
    assert judge.wrong_side_near(seen) > 0.97
    assert judge.wrong_side_far(seen) < 0.1
    ring_px = 26 * 46 - 20 * 40
    assert judge.swapped(seen) == pytest.approx(ring_px / (58 * 197))
    assert judge.all_error(seen) == pytest.approx(0.5 * ring_px / (58 * 197))
    assert judge.sure_and_wrong(seen) == pytest.approx(ring_px / (58 * 197))
    assert judge.inside_error(seen) == 0.0


def test_an_object_in_the_walls_depth_is_claimed_and_not_found() -> None:
    def vanish(maps: dict[str, np.ndarray]) -> None:
        maps["depth_m"][OBJECT] = WALL_M

    seen = _decoded(vanish)
    assert (judge.found(seen), judge.bars_found(seen), judge.bars_claimed(seen)) == (0.0, 0.0, 1.0)
    assert judge.worst_object_error(seen) == pytest.approx(1.0) and judge.has_astray(seen) == 1.0


def test_an_undecoded_object_is_neither_found_nor_claimed_and_counts_as_wholly_wrong() -> None:
    def empty(maps: dict[str, np.ndarray]) -> None:
        maps["depth_m"][OBJECT] = np.nan

    seen = _decoded(empty)
    assert (judge.found(seen), judge.bars_claimed(seen), judge.has_astray(seen)) == (0.0, 0.0, 0.0)
    assert judge.worst_object_error(seen) == 1.0 and judge.object_error(seen) == 0.5
    assert judge.last_object_share(seen) == 0.0 and judge.last_object_error(seen) == 1.0
    assert judge.decoded_share(seen) == pytest.approx(1.0 - 800 / (58 * 197))


def test_confidence_is_calibrated_where_that_share_is_right() -> None:
    def half(maps: dict[str, np.ndarray]) -> None:
        maps["confidence"][:] = 0.55
        maps["depth_m"][::2] *= 1.1

    confidence, right, count = judge.reliability(_decoded(half))
    assert confidence == pytest.approx([0.55]) and right == pytest.approx([0.5]) and count.sum() == 58 * 197
    assert judge.miscalibration(_decoded(half)) == pytest.approx(0.05)
    assert judge.sure_and_wrong(_decoded(half)) == 0.0


def test_sides_and_contrast() -> None:
    def lean(maps: dict[str, np.ndarray]) -> None:
        maps["depth_pixel_m"][:, 100:] *= 0.994
        maps["intensity_x"] *= 1.03

    seen = _decoded(lean)
    assert judge.side_bias(seen) == pytest.approx(0.006)
    assert judge.contrast_error(seen) == pytest.approx(0.03)


def test_the_pull_is_the_error_over_the_stated_one() -> None:
    def nearer(maps: dict[str, np.ndarray]) -> None:
        maps["depth_m"][OBJECT] *= 0.998

    def segment(number: int, depth_m: float, error_m: float) -> SegmentFigures:
        return SegmentFigures(number, 100, depth_m, 0.0, 0.0, error_m, 1.0, 0.0, 1.0)

    seen = _decoded(nearer)
    assert judge.pull(seen) == np.inf  # no segment has the depth
    segments = (segment(1, WALL_M, 1e-4), segment(2, 0.998 * OBJECT_M, 3e-4))
    assert judge.pull(replace(seen, image=replace(seen.image, segments=segments))) == pytest.approx(2.0)


def test_a_halo_about_a_highlight_is_a_tail() -> None:
    seen = _decoded()
    light = seen.true_intensity.copy()
    light[:, 28:30, 30:32] = 30e3
    decoded = 1.01 * light
    true = replace(seen.truth, intensity_x=light[0], intensity_y=light[1])
    clean = Decoded(seen.image, true, seen.depth_m, seen.own_depth_m, seen.confidence, decoded)
    assert judge.tails(clean) == pytest.approx(1.0)
    haloed = decoded.copy()
    haloed[:, 20:38, 22:40] += 100.0
    assert judge.tails(replace(clean, intensity=haloed)) > 1.5


def test_cases_have_names_of_their_own_and_unknown_ones_are_refused() -> None:
    names = [case.name for case in CASES]
    assert len(set(names)) == len(names) >= 16
    with pytest.raises(InputError, match="--only"):
        rows(True, only=("nothing",))
    with pytest.raises(InputError, match=r"scenes or expose or .* or cluster with --only"):
        benchmark.rows_of("psf", only=["edge"])


def test_a_run_goes_on_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames and figures are kept: only the frame of the picture is decoded again."""
    monkeypatch.setattr(scene_stacks, "KEPT", tmp_path)
    monkeypatch.setattr(scenes, "KEPT", tmp_path)
    scenes._stacks.cache_clear()
    decoded: list[str] = []
    decoder = scenes._decoder
    monkeypatch.setattr(scenes, "_decoder", lambda lens, frame: decoded.append(lens) or decoder(lens, frame))
    told: list[tuple[int, int]] = []

    def progress(step: str, done: int, total: int) -> None:
        told.append((done, total))

    first = rows(False, only=("first_page",), seeds=3, progress=progress)
    assert len(decoded) == 3 and told == [(0, 3), (1, 3), (2, 3), (3, 3)]
    again = rows(False, only=("first_page",), seeds=3)
    assert len(decoded) == 4
    assert [row["measured"] for row in again] == [row["measured"] for row in first]
    assert {row["seeds"] for row in again} == {3} and again[0]["view"] is not None
    scenes._stacks.cache_clear()
    assert scenes.Figures.of({"measured": ["inf", 0.5], "seconds": 1.0}).measured == (np.inf, 0.5)
