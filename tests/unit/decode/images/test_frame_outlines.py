"""Outlines between unlike contrasts stand between downsampled pixels, where the raw frame has them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from metafab.camera import capture
from metafab.decode.decoder import DecodedFrame, Decoder
from metafab.decode.images import frame_outlines
from metafab.decode.images.frame_outlines import outlines_by_frame
from metafab.decode.images.pixel_outlines import on_pixels
from metafab.decode.segmentation.layered.frame_model import FrameModel
from metafab.decode.segmentation.layered.layer_light import LayerOptics
from metafab.decode.segmentation.segments import Regions
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf


def photographed(contrast: float) -> tuple[DecodedFrame, LayerOptics, NDArray[np.bool_]]:
    """An object of a contrast before a wall of contrast 1, decoded, and the frame's pixels of the object."""
    psf = helix_psf(1.0 / np.linspace(1 / 0.0024, 1 / 0.0036, 9))
    wall = SceneObject(depth_m=0.0034, size=(0.6, 0.6))
    thing = SceneObject(depth_m=0.0028, size=(0.13, 0.22), polarisation_contrast=contrast)
    frame = capture(Scene(objects=(wall, thing), photons_per_pixel=3000.0, field_px=(220, 164), seed=4), psf)
    decoder = Decoder.of(psf, frame.frame.shape, frame.origin_um, frame.x_window)
    assert decoder is not None and frame.truth is not None
    prepared = decoder.prepare(frame)
    assert not isinstance(prepared, str)
    return decoder.complete(decoder.match(prepared)), decoder.layer_optics, frame.truth.label == 2


@pytest.fixture(scope="module")
def unlike() -> tuple[DecodedFrame, LayerOptics, NDArray[np.bool_]]:
    """An object of three times the wall's contrast."""
    return photographed(3.0)


def labelled(frame: DecodedFrame, own: NDArray[np.bool_], by: int) -> Regions:
    """The frame's segments with the true outline, of downsampled pixels, moved outward by pixels of the frame."""
    step = frame.prepared.downsampling.step
    near = 1 + int(np.argmax([depth.vergence_per_m for depth in frame.regions.depths]))
    row, column = (np.nonzero(own.any(axis=axis))[0] for axis in (1, 0))
    moved = np.zeros_like(own)
    moved[row[0] - by : row[-1] + 1 + by, column[0] - by : column[-1] + 1 + by] = True
    label = np.where(moved[::step, ::step], near, 3 - near).astype(np.int32)
    interior = np.where(label == frame.regions.interior, label, 0).astype(np.int32)
    sure = np.full(label.shape, 0.9)
    return replace(frame.regions, grown=label, label=label, interior=interior, right=sure, beyond_px=None)


@pytest.mark.parametrize("by", [-3, 0, 3])
def test_an_outline_is_displaced_to_where_it_is(
    unlike: tuple[DecodedFrame, LayerOptics, NDArray[np.bool_]], by: int
) -> None:
    """Of the pixels between the true outline and one up to 3 px off, 41 to 54 % come back; segments keep their pixels.

    Downsampled pixels cover 1 px more or less than the object. An outline is displaced by 2 px at most.
    """
    frame, optics, own = unlike
    step, regions = frame.prepared.downsampling.step, labelled(frame, own, by)
    near = regions.grown[regions.grown.shape[0] // 2, regions.grown.shape[1] // 2]
    found = outlines_by_frame(regions, frame.prepared, optics, step)
    assert found.beyond_px is not None and (found.grown == regions.grown).all()
    wrong_before, wrong = (
        int(((on_pixels(one.grown, step, own.shape, one.beyond_px)(one.grown) == near) != own).sum())
        for one in (regions, found)
    )
    assert wrong < 0.7 * wrong_before


def test_outlines_between_like_contrasts_stay(unlike: tuple[DecodedFrame, LayerOptics, NDArray[np.bool_]]) -> None:
    """Nothing that is not asked is displaced: like contrasts, pixels without a depth, and one segment alone."""
    frame, optics, own = unlike
    step, regions = frame.prepared.downsampling.step, labelled(frame, own, 2)
    refused = replace(regions, right=np.zeros(regions.grown.shape))
    assert outlines_by_frame(refused, frame.prepared, optics, step) is refused
    alone = replace(regions, depths=regions.depths[:1])
    assert outlines_by_frame(alone, frame.prepared, optics, step) is alone
    same, same_optics, _ = photographed(1.0)
    assert outlines_by_frame(same.regions, same.prepared, same_optics, step) is same.regions


def test_contrasts_differ_only_where_they_are_known(
    unlike: tuple[DecodedFrame, LayerOptics, NDArray[np.bool_]],
) -> None:
    """A segment without pixels away from its outline is unlike none; no segment is unlike itself or no segment."""
    frame, optics, own = unlike
    regions = labelled(frame, own, 0)
    assert FrameModel(frame.prepared, regions, optics).unlike[1:].tolist() == [
        [False, False, True],
        [False, True, False],
    ]
    near = regions.grown[regions.grown.shape[0] // 2, regions.grown.shape[1] // 2]
    bar = regions.grown == near
    bar[:, : bar.shape[1] // 2] = False
    bar[:, bar.shape[1] // 2 + 4 :] = False
    thin = np.where(bar, near, 3 - near).astype(np.int32)
    narrow = replace(regions, grown=thin, label=thin)
    assert not FrameModel(frame.prepared, narrow, optics).unlike.any()


def test_the_least_misfit_is_that_of_a_parabola() -> None:
    """Between the displacements where it lies there, at the end where it lies beyond, 0 where it falls by little.

    The prior is 12 in the square of the displacement: with a misfit of 40, the least is at 40/52 of its place.
    """
    at = np.array([-1.0, 0.0, 1.0])[:, None, None]
    for place, factor, expected in ((0.4, 40.0, 16 / 52), (1.7, 40.0, 1.0), (-0.4, 4.0, 0.0), (-0.6, 40.0, -24 / 52)):
        misfits = (factor * (at - place) ** 2).astype(np.float32)
        np.testing.assert_allclose(frame_outlines.least_misfit_px(misfits, 3), 3.0 * expected, rtol=1e-4)
    falling = np.array([20.0, 15.0, -60.0], dtype=np.float32)[:, None, None]
    np.testing.assert_allclose(frame_outlines.least_misfit_px(falling, 2), 2.0)


def test_where_the_model_leaves_much_its_misfits_count_less(
    unlike: tuple[DecodedFrame, LayerOptics, NDArray[np.bool_]],
) -> None:
    """An outline 12 px too far out leaves many variances of the noise: with any displacement they are the unit."""
    frame, optics, own = unlike
    regions, step = labelled(frame, own, 12), frame.prepared.downsampling.step
    across = (3 - regions.grown).astype(np.int32)
    everywhere = np.ones(across.shape, dtype=bool)
    inside = np.full(across.shape, 30.0, dtype=np.float32)
    found = FrameModel(frame.prepared, regions, optics).displaced_misfits(inside, across, (-1.0, 0.0, 1.0), everywhere)
    assert found is not None
    # Two values of each pixel, summed under a Gaussian of a standard deviation of 4 frame pixels.
    most = 2.0 * 2.0 * np.pi * (4.0 / step) ** 2
    least = found.min(axis=0)
    assert (least <= 1.001 * most).all()
    assert (least >= 0.999 * most).mean() > 0.02
