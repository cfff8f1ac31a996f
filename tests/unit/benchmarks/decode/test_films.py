"""Growth of memory over many frames, from decoders that leak and that do not."""

from __future__ import annotations

import itertools
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

import numpy as np
import pytest

from benchmarks.decode.films import SHOWN, row_of
from metafab.camera import RawFrame, capture
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf


def small_frame() -> RawFrame:
    scene = Scene(objects=(SceneObject(depth_m=0.003, size=(0.2, 0.2)),), field_px=(40, 50), seed=1)
    return capture(scene, helix_psf(1.0 / np.linspace(1 / 0.0028, 1 / 0.0032, 3)))


class Leak:
    """A decoder that keeps a megabyte of each frame's light, or gives it back."""

    nmae = 0.01

    def __init__(self, *, keeps: bool) -> None:
        self.kept: list[np.ndarray] = []
        self.seen: list[float] = []
        self.keeps = keeps

    def __call__(self, frame: RawFrame) -> Leak:
        block = np.full(125_000, frame.frame.sum(), dtype=np.float64)
        self.seen.append(float(block[0]))
        if self.keeps:
            self.kept.append(block)
        return self


def leaking(*, keeps: bool) -> dict[str, Any]:
    return row_of("leak", [small_frame()], Leak(keeps=keeps), 200)


def in_a_fresh_process(*, keeps: bool) -> dict[str, Any]:
    """The row of a process that holds no freed memory of other tests, which a leak would use again."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(leaking, keeps=keeps).result()


def test_a_leak_is_measured() -> None:
    row = in_a_fresh_process(keeps=True)
    # A megabyte a frame; the rest of the process moves by some of them.
    assert row["growth_mb"] == pytest.approx(1e4, rel=0.2)
    assert row["last_mb"] - row["resident_mb"] == pytest.approx(180.0, rel=0.2)


def test_no_growth_without_a_leak() -> None:
    assert abs(in_a_fresh_process(keeps=False)["growth_mb"]) < 500.0


def test_frames_go_there_and_back_with_fresh_noise() -> None:
    decoder, frame = Leak(keeps=False), small_frame()
    row_of("order", [frame, frame, frame], decoder, 6 * SHOWN)
    assert len(set(decoder.seen)) == len(decoder.seen) == 6 * SHOWN
    assert all(one != other for one, other in itertools.pairwise(decoder.seen))
