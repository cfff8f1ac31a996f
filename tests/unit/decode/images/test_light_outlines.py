"""Outlines move to edges of the light where the model of the frame agrees, and raise doubt where it is indifferent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import binary_erosion

from metafab.camera import capture
from metafab.decode.decoder import DecodedFrame, Decoder
from metafab.decode.images.light_outlines import outlines_at_edges
from metafab.decode.segmentation.frame_model import FrameModel
from metafab.decode.segmentation.layer_light import LayerOptics
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf

SMALLER = 3


@pytest.fixture(scope="module")
def decoded() -> tuple[DecodedFrame, LayerOptics]:
    """A bright object before a wall of the same contrast."""
    psf = helix_psf(1.0 / np.linspace(1 / 0.0024, 1 / 0.0036, 9))
    wall = SceneObject(depth_m=0.0034, size=(0.6, 0.6))
    thing = SceneObject(depth_m=0.0026, size=(0.12, 0.22), brightness=2.0, polarisation_contrast=1.6)
    frame = capture(Scene(objects=(wall, thing), photons_per_pixel=3000.0, field_px=(200, 160), seed=4), psf)
    decoder = Decoder.of(psf, frame.frame.shape, frame.origin_um, frame.x_window)
    assert decoder is not None
    prepared = decoder.prepare(frame)
    assert not isinstance(prepared, str)
    return decoder.complete(prepared, decoder.match(prepared)), decoder.layer_optics


@pytest.mark.parametrize("has_edges", [True, False])
def test_an_object_too_small_grows_to_the_edge_of_its_light(
    decoded: tuple[DecodedFrame, LayerOptics], has_edges: bool
) -> None:
    """Even light has no edges: outlines where segments then meet explain nothing, and no pixel moves."""
    frame, optics = decoded
    regions, step = frame.regions, frame.prepared.downsampling.step
    assert len(regions.depths) == 2
    own = regions.grown == 1 + int(np.argmax([depth.vergence_per_m for depth in regions.depths]))
    lost = own & ~binary_erosion(own, iterations=SMALLER)
    label = np.where(lost, 3 - regions.grown, regions.grown).astype(np.int32)
    sure = np.full(label.shape, 0.95)
    small = replace(regions, grown=label, label=label, interior=np.where(lost, 0, regions.interior), right=sure)
    sharp = frame.sharp if has_edges else replace(frame.sharp, images=np.ones_like(frame.sharp.images))
    found = outlines_at_edges(small, frame.prepared, sharp, optics, step)
    assert found.right is not None
    moved = found.grown != label
    assert (found.right[moved] < 0.9).all()
    assert (found.grown == regions.grown)[lost].mean() > 0.9 if has_edges else not moved.any()


def test_doubt_rises_where_the_frame_fits_either_outline(
    decoded: tuple[DecodedFrame, LayerOptics], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pixels that would move to an edge of the light without a change of the misfit are no longer sure."""
    frame, optics = decoded
    sure = np.full(frame.regions.grown.shape, 0.95)
    monkeypatch.setattr(FrameModel, "gain_of_moves", lambda _, moved: np.zeros(moved.shape, dtype=np.float32))
    regions = replace(frame.regions, right=sure)
    found = outlines_at_edges(regions, frame.prepared, frame.sharp, optics, frame.prepared.downsampling.step)
    assert found.right is not None and (found.grown == regions.grown).all()
    doubted = found.right < 0.9
    assert doubted.any() and not doubted[regions.interior > 0].any()
