"""Memory of the layers in tiles, as it is estimated before they are made."""

from __future__ import annotations

import gc
import tracemalloc

import numpy as np
import pytest

from metafab.camera import capture
from metafab.decode import decode
from metafab.decode.segmentation.layered import layer_tiles
from metafab.decode.segmentation.layered.frame_model import FrameModel
from metafab.decode.segmentation.layered.layer_tiles import FrameLayers, TileGroup
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf


def test_tiles_take_the_memory_that_is_estimated(monkeypatch: pytest.MonkeyPatch) -> None:
    """The peak of Python's allocations, less what was held before, of a frame of a wall and 12 squares before it."""
    pixels: list[int] = []
    peaks: list[int] = []
    groups, owners = FrameLayers.groups, FrameModel.owners

    def counted(self: FrameLayers, near: np.ndarray | None = None) -> list[TileGroup]:
        found = groups(self, near)
        pixels.append(sum(len(group.layer) for group in found) * int(np.prod(self.optics.tiling.size)))
        return found

    def traced(self: FrameModel) -> np.ndarray | None:
        pixels.clear()
        gc.collect()
        tracemalloc.start()
        held, _ = tracemalloc.get_traced_memory()
        try:
            return owners(self)
        finally:
            peaks.append(tracemalloc.get_traced_memory()[1] - held)
            tracemalloc.stop()

    monkeypatch.setattr(FrameLayers, "groups", counted)
    monkeypatch.setattr(FrameModel, "owners", traced)
    rng, objects = np.random.default_rng(0), [SceneObject(depth_m=0.0034, size=(0.9, 3.9))]
    for y in (-0.18, -0.06, 0.06, 0.18):
        for x in (-0.08, 0.0, 0.08):
            depth_m, light = float(rng.uniform(0.0025, 0.0033)), float(rng.uniform(0.7, 1.3))
            objects.append(SceneObject(depth_m=depth_m, size=(0.06, 0.06), centre=(x, y), brightness=light))
    pair = helix_psf(1.0 / np.linspace(1 / 0.00238, 1 / 0.0037, 11))
    frame = capture(Scene(objects=tuple(objects), field_px=(300, 170), seed=7), pair)  # its draw is decoded by layers
    decode(frame, pair)
    assert pixels and pixels[0] > 30 * 7200
    # 94 to 130 bytes were measured; other threads and other scenes take some more or less.
    assert 0.6 < peaks[-1] / (pixels[0] * layer_tiles.BYTES_A_PIXEL) < 1.15
