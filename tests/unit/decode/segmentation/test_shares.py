"""Parts of the model of the frame along outlines."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from metafab.camera import capture
from metafab.decode.decoder import Decoder
from metafab.decode.segmentation import shares
from metafab.decode.segmentation.planes import Plane
from metafab.decode.segmentation.prepared_frame import PreparedFrame
from metafab.decode.segmentation.regions import find_regions, textured_pixel_depth
from metafab.decode.segmentation.shares import explained_moves, false_pieces, outline_owners
from metafab.decode.segmentation.tile_shares import TileLayers
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf


def test_one_surface_is_not_modelled() -> None:
    """A scene without outlines costs nothing more."""
    psf = helix_psf(1.0 / np.linspace(1 / 0.0024, 1 / 0.0036, 9))
    scene = Scene(objects=(SceneObject(depth_m=0.003, size=(0.5, 0.5)),), field_px=(120, 150), seed=1)
    frame = capture(scene, psf)
    decoder = Decoder.of(psf, frame.frame.shape, frame.origin_um, frame.x_window)
    assert decoder is not None
    prepared = decoder.prepare(frame)
    assert not isinstance(prepared, str)
    volume = decoder.match(prepared)
    regions = find_regions(prepared, volume, textured_pixel_depth(prepared, volume))
    assert len(regions.depths) == 1
    model = (prepared, regions.depths, regions.grown, regions.interior, decoder.layer_optics)
    assert outline_owners(*model) is None


def test_the_texture_of_a_corner_is_not_that_of_its_layer() -> None:
    """A few pixels away from outlines, at a bright rim, do not scale a layer: it would lose the pixels in dispute."""
    energy = np.ones((2, 10, 10), dtype=np.float32)
    energy[:, 8:] = 4.0
    labelled, alone = np.ones((2, 10, 10), dtype=bool), np.zeros((2, 10, 10), dtype=bool)
    alone[0, 8:], alone[1, 2:] = True, True
    model = cast(TileLayers, None)
    group = shares._Group([0], np.array([0, 1]), model, energy, labelled, alone)
    assert shares._typical_energy([group], [energy], 3).tolist() == [1.0, 1.0, 1.0]
    energy[1, :6] = 2.0  # three quarters of its pixels away from outlines
    assert shares._typical_energy([group], [energy], 3).tolist() == [1.0, 2.0, 1.0]


@pytest.fixture(scope="module")
def wall_and_object() -> tuple[PreparedFrame, dict[str, Any]]:
    """A wall and an object before it: the frame, and segments of true depths with the labels of correlation."""
    psf = helix_psf(1.0 / np.linspace(1 / 0.0024, 1 / 0.0036, 9))
    wall, thing = SceneObject(depth_m=0.0034, size=(0.6, 0.6)), SceneObject(depth_m=0.0026, size=(0.12, 0.22))
    frame = capture(Scene(objects=(wall, thing), photons_per_pixel=3000.0, field_px=(200, 160), seed=4), psf)
    decoder = Decoder.of(psf, frame.frame.shape, frame.origin_um, frame.x_window)
    assert decoder is not None
    prepared = decoder.prepare(frame)
    assert not isinstance(prepared, str)
    volume = decoder.match(prepared)
    regions = find_regions(prepared, volume, textured_pixel_depth(prepared, volume), optics=decoder.layer_optics)
    assert len(regions.depths) == 2
    return prepared, {"depths": regions.depths, "label": regions.grown, "interior": regions.interior} | {
        "optics": decoder.layer_optics
    }


def test_dark_parts_within_an_object_are_its_own(wall_and_object: tuple[PreparedFrame, dict[str, Any]]) -> None:
    """Their light is small but known; a frame without any there fits no outline nearby."""
    prepared, segments = wall_and_object
    nearest = 1 + int(np.argmax([depth.vergence_per_m for depth in segments["depths"]]))
    row, column = (int(np.median(axis)) for axis in np.nonzero(segments["label"] == nearest))
    hole = (slice(row - 2, row + 3), slice(column - 2, column + 3))
    dark = replace(prepared)
    vars(dark)["lit"] = prepared.lit.copy()
    dark.lit[hole] = False
    owner = outline_owners(dark, **segments)
    assert owner is not None and (owner[hole] == nearest).all()


@pytest.mark.parametrize("is_there", [False, True])
def test_a_piece_that_its_neighbours_explain_better_is_false(
    wall_and_object: tuple[PreparedFrame, dict[str, Any]], is_there: bool
) -> None:
    """A nearer depth along the outline is none; the object itself is one, however narrow."""
    prepared, segments = wall_and_object
    depths, label, interior = segments["depths"], segments["label"].copy(), segments["interior"]
    nearest = 1 + int(np.argmax([depth.vergence_per_m for depth in depths]))
    if is_there:
        assert false_pieces(prepared, **segments, narrow=[nearest]) == []
        return
    row, column = np.nonzero(label == nearest)
    label[row.min() : row.max(), column.max() - 5 : column.max() + 6] = 3
    nearer = 1.0 / 0.00245
    piece = replace(depths[0], vergence_per_m=nearer, plane=Plane(nearer))
    model = {"depths": (*depths, piece), "label": label, "interior": np.where(label == 3, 0, interior)}
    assert false_pieces(prepared, **model, optics=segments["optics"], narrow=[3]) == [3]


def test_moves_of_pixels_are_judged_by_the_light_about_them(
    wall_and_object: tuple[PreparedFrame, dict[str, Any]],
) -> None:
    """Half of an object given to the wall does not explain the frame; given back, it does."""
    prepared, segments = wall_and_object
    label = segments["label"]
    nearest = 1 + int(np.argmax([depth.vergence_per_m for depth in segments["depths"]]))
    rows = np.nonzero(label == nearest)[0]
    half = label == nearest
    half[int(np.median(rows)) :] = False
    without = np.where(half, 3 - nearest, label).astype(np.int32)
    assert not explained_moves(prepared, **segments, moved=without).any()
    back = explained_moves(prepared, **segments | {"label": without}, moved=label)
    assert back[half].mean() > 0.9 and not back[~half].any()
