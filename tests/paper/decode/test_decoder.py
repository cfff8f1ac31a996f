"""The paper's claims about depth and polarisation, on a simulated scene with noise.

The scene is the small design's: three pieces at scaled depths of 26, 29 and 33 cm, one of them polarising by 2.5,
3000 electrons a pixel; the pair varies over the field.
"""

from __future__ import annotations

import numpy as np
import pytest

from metafab.camera import RawFrame, capture
from metafab.decode import Image4D, decode
from metafab.optics.point_spread import Psf
from metafab.spec import Design
from tests.conjugate_pair import helix_psf


@pytest.fixture(scope="module")
def psf() -> Psf:
    depth_m = 1.0 / np.linspace(1 / 0.00245, 1 / 0.0035, 9)
    return helix_psf(depth_m, tangents=(np.linspace(-0.105, 0.105, 7), np.linspace(-0.13, 0.13, 3)))


@pytest.fixture(scope="module")
def frame(small_design: Design, psf: Psf) -> RawFrame:
    return capture(small_design.scene, psf)


@pytest.fixture(scope="module")
def image(frame: RawFrame, psf: Psf) -> Image4D:
    return decode(frame, psf)


def test_nmae_is_below_one_per_cent(image: Image4D) -> None:
    """Indoor scenes: 0.37 %, and "below 1 %" with more objects over 25 to 34 cm."""
    assert image.nmae is not None
    assert image.nmae < 0.01
    assert image.figures.share_decoded > 0.97


def test_the_polarising_piece_stands_out(small_design: Design, image: Image4D) -> None:
    """Metal and other materials are told apart by I_x / I_y."""
    for piece in small_design.scene.objects:
        row = min(image.segments, key=lambda r: abs(r.depth_m - piece.depth_m))
        # 2 %, and what an outline's pixels mix in.
        assert row.contrast == pytest.approx(piece.polarisation_contrast, rel=0.03)


def test_the_twins_are_side_by_side(frame: RawFrame) -> None:
    """Two separate images: dark columns between them."""
    assert frame.truth is not None
    columns = frame.frame.mean(axis=0)
    axis = round(-frame.origin_um[0] / frame.pixel_um)
    assert columns[axis - 5 : axis + 5].max() < 0.1 * columns.max()
