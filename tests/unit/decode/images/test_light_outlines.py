"""Outlines move to edges of the light where the model of the frame agrees, and raise doubt where it is indifferent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

from metafab.camera import capture
from metafab.decode.decoder import DecodedFrame, Decoder
from metafab.decode.images.light_outlines import outlines_at_edges
from metafab.decode.segmentation.layered.frame_model import FrameModel
from metafab.decode.segmentation.layered.layer_light import LayerOptics
from metafab.decode.segmentation.segments import Regions
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf

SMALLER = 3
DRAWS = 3


@pytest.fixture(scope="module")
def decoded() -> list[tuple[DecodedFrame, LayerOptics, NDArray[np.bool_]]]:
    """A bright object before a wall in three draws of the textures, and the downsampled pixels of the object.

    Draws whose wall falls into two segments, 1 % apart, are left out: rounding decides which do.
    """
    psf = helix_psf(1.0 / np.linspace(1 / 0.0024, 1 / 0.0036, 9))
    wall = SceneObject(depth_m=0.0034, size=(0.6, 0.6))
    thing = SceneObject(depth_m=0.0026, size=(0.12, 0.22), brightness=2.0, polarisation_contrast=1.6)
    frames: list[tuple[DecodedFrame, LayerOptics, NDArray[np.bool_]]] = []
    for seed in range(4, 4 + 2 * DRAWS):
        frame = capture(Scene(objects=(wall, thing), photons_per_pixel=3000.0, field_px=(200, 160), seed=seed), psf)
        decoder = Decoder.of(psf, frame.frame.shape, frame.origin_um, frame.x_window)
        assert decoder is not None
        prepared = decoder.prepare(frame)
        assert not isinstance(prepared, str)
        found = decoder.complete(decoder.match(prepared))
        assert frame.truth is not None
        if len(found.regions.depths) != 2:
            continue
        step = found.prepared.downsampling.step
        frames.append((found, decoder.layer_optics, frame.truth.label[::step, ::step] == 2))
        if len(frames) == DRAWS:
            return frames
    raise AssertionError(f"{len(frames)} draws of {2 * DRAWS} have two segments")


@pytest.mark.parametrize("has_edges", [True, False])
def test_an_object_too_small_grows_to_the_edge_of_its_light(
    decoded: list[tuple[DecodedFrame, LayerOptics, NDArray[np.bool_]]], has_edges: bool
) -> None:
    """Most of what was cut off comes back; even light has no edges, and no pixel moves.

    Of 600 pixels on the wrong side 110 to 330 are left in single frames, by the textures and by rounding; on average a
    third.
    """
    wrong_before = wrong = 0
    for frame, optics, own in decoded:
        step, near = frame.prepared.downsampling.step, nearest_segment(frame.regions)
        small = binary_erosion(own, iterations=SMALLER)
        label, truth = (np.where(mask, near, 3 - near).astype(np.int32) for mask in (small, own))
        interior = np.where(label == frame.regions.interior, label, 0)
        sure = np.full(label.shape, 0.95)
        regions = replace(frame.regions, grown=label, label=label, interior=interior, right=sure)
        sharp = frame.sharp if has_edges else replace(frame.sharp, images=np.ones_like(frame.sharp.images))
        found = outlines_at_edges(regions, frame.prepared, sharp, optics, step)
        assert found.right is not None
        moved = found.grown != label
        assert (found.right[moved] < 0.9).all()
        assert has_edges or not moved.any()
        wrong_before += int((label != truth).sum())
        wrong += int((found.grown != truth).sum())
    assert wrong < 0.5 * wrong_before or not has_edges


def nearest_segment(regions: Regions) -> int:
    """Number of the nearer of two segments."""
    return 1 + int(np.argmax([depth.vergence_per_m for depth in regions.depths]))


def test_doubt_rises_where_the_frame_fits_either_outline(
    decoded: list[tuple[DecodedFrame, LayerOptics, NDArray[np.bool_]]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pixels that would move to an edge of the light without a change of the misfit are no longer sure."""
    frame, optics, _ = decoded[0]
    sure = np.full(frame.regions.grown.shape, 0.95)
    monkeypatch.setattr(FrameModel, "gain_of_moves", lambda _, moved: np.zeros(moved.shape, dtype=np.float32))
    regions = replace(frame.regions, right=sure)
    found = outlines_at_edges(regions, frame.prepared, frame.sharp, optics, frame.prepared.downsampling.step)
    assert found.right is not None and (found.grown == regions.grown).all()
    doubted = found.right < 0.9
    assert doubted.any() and not doubted[regions.interior > 0].any()
