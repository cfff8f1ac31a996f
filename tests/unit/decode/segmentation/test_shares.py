"""Parts of the model of the frame along outlines."""

from __future__ import annotations

from typing import cast

import numpy as np

from metafab.camera import capture
from metafab.decode.decoder import Decoder
from metafab.decode.segmentation import shares
from metafab.decode.segmentation.regions import find_regions, textured_pixel_depth
from metafab.decode.segmentation.shares import outline_owners
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
