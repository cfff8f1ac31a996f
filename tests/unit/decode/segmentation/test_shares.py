"""Parts of the model of the frame along outlines."""

from __future__ import annotations

import numpy as np

from metafab.camera import capture
from metafab.decode.decoder import Decoder
from metafab.decode.segmentation.regions import find_regions, textured_pixel_depth
from metafab.decode.segmentation.shares import outline_owners
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
