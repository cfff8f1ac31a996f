"""One thread or two: the same bytes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from metafab.camera import RawFrame, capture
from metafab.core.parallel import executor
from metafab.decode import Decoder, Image4D, VideoDecoder
from metafab.optics.point_spread import Psf
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf

SCENE = Scene(
    objects=(
        SceneObject(depth_m=0.0032, centre=(0.06, 0.0), size=(0.09, 0.09), polarisation_contrast=2.0),
        SceneObject(depth_m=0.0028, centre=(-0.07, 0.0), size=(0.08, 0.12), tilt=(0.08, 0.0)),
    ),
    field_px=(120, 160), seed=2,
)  # fmt: skip


@pytest.fixture(scope="module")
def psf() -> Psf:
    tangents = np.linspace(-0.12, 0.12, 3)
    return helix_psf(1.0 / np.linspace(1 / 0.00245, 1 / 0.0036, 9), tangents=(tangents, tangents))


def decoded(decoder: Decoder, frames: list[RawFrame]) -> list[Image4D]:
    """A frame by itself, and two of a film."""
    video = VideoDecoder(decoder)
    return [decoder(frames[0]), *(video(frame) for frame in frames)]


def test_the_result_does_not_depend_on_the_number_of_threads(psf: Psf, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = [capture(SCENE, psf, seed=seed) for seed in (1, 2)]
    # Broken pixels take the longer way: in each of both images, by itself and across the outline of both objects.
    broken = frames[0].frame.copy()
    broken[30, 40] = np.nan
    broken[60:64, ::20] = np.nan
    frames[0] = dataclasses.replace(frames[0], frame=broken)
    decoder = Decoder.of(psf, frames[0].frame.shape, frames[0].origin_um, frames[0].x_window)
    assert decoder is not None
    images = []
    for threads in (1, 3):
        monkeypatch.setattr(executor, "default_workers", lambda threads=threads: threads)
        images.append(decoded(decoder, frames))
    for one, two in zip(*images, strict=True):
        assert len(one.segments) >= 2
        assert one.segments == two.segments
        for field in dataclasses.fields(Image4D):
            a, b = getattr(one, field.name), getattr(two, field.name)
            if isinstance(a, np.ndarray):
                assert a.tobytes() == b.tobytes(), field.name


def test_a_decoder_keeps_nothing_that_later_frames_see(psf: Psf) -> None:
    """What it keeps between frames does not depend on their order."""
    frames = [capture(SCENE, psf, seed=seed) for seed in (1, 2, 3)]
    decoder = Decoder.of(psf, frames[0].frame.shape, frames[0].origin_um, frames[0].x_window)
    assert decoder is not None
    forwards = [decoder(frame).depth_m for frame in frames]
    backwards = [decoder(frame).depth_m for frame in reversed(frames)]
    for a, b in zip(forwards, reversed(backwards), strict=True):
        np.testing.assert_array_equal(a, b)
