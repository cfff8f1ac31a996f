"""Parts of the model of the frame along outlines."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from metafab.camera import capture
from metafab.decode.decoder import Decoder
from metafab.decode.segmentation.layered import frame_model
from metafab.decode.segmentation.layered.frame_model import FrameModel
from metafab.decode.segmentation.layered.layer_tiles import TileGroup
from metafab.decode.segmentation.layered.tile_shares import TileLayers
from metafab.decode.segmentation.planes import Plane
from metafab.decode.segmentation.regions import find_regions, textured_pixel_depth
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
    volume = decoder.match(prepared).volume
    regions = find_regions(prepared, volume, textured_pixel_depth(prepared, volume))
    assert len(regions.depths) == 1
    assert FrameModel(prepared, regions, decoder.layer_optics).owners() is None


def test_the_texture_of_a_corner_is_not_that_of_its_layer() -> None:
    """A few pixels away from outlines, at a bright rim, do not scale a layer: it would lose the pixels in dispute."""
    energy = np.ones((2, 10, 10), dtype=np.float32)
    energy[:, 8:] = 4.0
    labelled, alone = np.ones((2, 10, 10), dtype=bool), np.zeros((2, 10, 10), dtype=bool)
    alone[0, 8:], alone[1, 2:] = True, True
    model = cast(TileLayers, None)
    group = TileGroup([0], np.array([0, 1]), model, energy, labelled)
    vars(group)["alone"] = alone
    assert frame_model.typical_energy([group], [energy], 3).tolist() == [1.0, 1.0, 1.0]
    energy[1, :6] = 2.0  # three quarters of its pixels away from outlines
    assert frame_model.typical_energy([group], [energy], 3).tolist() == [1.0, 2.0, 1.0]


@pytest.fixture(scope="module")
def wall_and_object() -> FrameModel:
    """A wall and an object before it: the frame, and segments of true depths with the labels of correlation."""
    psf = helix_psf(1.0 / np.linspace(1 / 0.0024, 1 / 0.0036, 9))
    wall, thing = SceneObject(depth_m=0.0034, size=(0.6, 0.6)), SceneObject(depth_m=0.0026, size=(0.12, 0.22))
    frame = capture(Scene(objects=(wall, thing), photons_per_pixel=3000.0, field_px=(200, 160), seed=4), psf)
    decoder = Decoder.of(psf, frame.frame.shape, frame.origin_um, frame.x_window)
    assert decoder is not None
    prepared = decoder.prepare(frame)
    assert not isinstance(prepared, str)
    volume = decoder.match(prepared).volume
    regions = find_regions(prepared, volume, textured_pixel_depth(prepared, volume), optics=decoder.layer_optics)
    assert len(regions.depths) == 2
    return FrameModel(prepared, regions, decoder.layer_optics)


def nearest_and_label(model: FrameModel) -> tuple[int, NDArray[np.int32]]:
    """Number of the object's segment, and a copy of the segments' labels."""
    return 1 + int(np.argmax([depth.vergence_per_m for depth in model.regions.depths])), model.regions.grown.copy()


def test_dark_parts_within_an_object_are_its_own(wall_and_object: FrameModel) -> None:
    """Their light is small but known; a frame without any there fits no outline nearby."""
    nearest, label = nearest_and_label(wall_and_object)
    row, column = (int(np.median(axis)) for axis in np.nonzero(label == nearest))
    hole = (slice(row - 2, row + 3), slice(column - 2, column + 3))
    dark = replace(wall_and_object.prepared)
    vars(dark)["lit"] = dark.lit.copy()
    dark.lit[hole] = False
    owner = replace(wall_and_object, prepared=dark).owners()
    assert owner is not None and (owner[hole] == nearest).all()


@pytest.mark.parametrize("is_there", [False, True])
def test_a_piece_that_its_neighbours_explain_better_is_false(wall_and_object: FrameModel, is_there: bool) -> None:
    """A nearer depth along the outline is none; the object itself is one, however narrow."""
    nearest, label = nearest_and_label(wall_and_object)
    if is_there:
        assert wall_and_object.false_pieces([nearest]) == []
        return
    regions = wall_and_object.regions
    row, column = np.nonzero(label == nearest)
    label[row.min() : row.max(), column.max() - 5 : column.max() + 6] = 3
    nearer = 1.0 / 0.00245
    piece = replace(regions.depths[0], vergence_per_m=nearer, plane=Plane(nearer))
    interior = np.where(label == 3, 0, regions.interior)
    three = replace(regions, depths=(*regions.depths, piece), grown=label, interior=interior)
    assert replace(wall_and_object, regions=three).false_pieces([3]) == [3]


def test_moves_of_pixels_are_judged_by_the_light_about_them(wall_and_object: FrameModel) -> None:
    """Half of an object given to the wall does not explain the frame; given back, it does."""
    nearest, label = nearest_and_label(wall_and_object)
    half = label == nearest
    half[int(np.median(np.nonzero(half)[0])) :] = False
    without = np.where(half, 3 - nearest, label).astype(np.int32)
    assert not wall_and_object.explained_moves(without).any()
    back = replace(wall_and_object, regions=replace(wall_and_object.regions, grown=without)).explained_moves(label)
    assert back[half].mean() > 0.9 and not back[~half].any()
