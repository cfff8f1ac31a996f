"""Textures integrated out of the model of a small object: slopes from draws against a dense determinant."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from metafab.camera import capture
from metafab.decode.decoder import Decoder
from metafab.decode.segmentation.objects import object_window
from metafab.decode.segmentation.objects.object_scene import DepthOptics, WindowScene
from metafab.decode.segmentation.objects.object_solver import determinant_slopes
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf


def test_slopes_of_the_determinant_are_those_of_the_dense_matrix(monkeypatch: pytest.MonkeyPatch) -> None:
    """The determinant grows with the object's vergence: a fit without it has the object too near."""
    psf = helix_psf(1.0 / np.linspace(1 / 0.0038, 1 / 0.0024, 13))
    wall = SceneObject(depth_m=0.0034, size=(0.6, 0.6))
    frame = capture(Scene(objects=(wall,), photons_per_pixel=3000.0, field_px=(120, 120), seed=1), psf)
    decoder = Decoder.of(psf, frame.frame.shape, frame.origin_um, frame.x_window)
    assert decoder is not None
    prepared = decoder.prepare(replace(frame, truth=None))
    assert not isinstance(prepared, str)
    for name, value in (("_SIDE", 8), ("_RIM", 1), ("_ROOM", 2)):
        monkeypatch.setattr(object_window, name, value)
    middle = prepared.downsampling.shape[0] // 2, prepared.downsampling.shape[1] // 2
    start = object_window.ObjectStart(middle, 4, 1.0 / 0.0034, np.ones(2), 1.0 / 0.0029, np.array([0.0, 0.0, 3.0, 3.0]))
    window = object_window.ObjectWindow.of(prepared, decoder.layer_optics, [start])
    n = window.side
    unknowns = np.array([[-math.log(0.0029), n / 2, n / 2, 3.0, 3.0, 1.0, 1.0, 1.0, 1.0]])

    def half_determinant(log_vergence: float) -> float:
        scene = WindowScene.of(window, DepthOptics.of(window, np.array([log_vergence])), unknowns)
        points = np.zeros((2 * n * n, 1, 2, n, n), dtype=np.float32)
        points.reshape(2 * n * n, -1)[np.arange(2 * n * n), np.arange(2 * n * n)] = 1.0
        images = window.weight * scene.textured(window.spectra(points))
        flat = images.reshape(len(images), -1).astype(np.float64)
        return 0.5 * float(np.linalg.slogdet(np.eye(len(flat)) + flat @ flat.T)[1])

    step = 0.01
    # Measured: 52.2, and 54.2 by a hundred draws.
    dense = (half_determinant(unknowns[0, 0] + step) - half_determinant(unknowns[0, 0] - step)) / (2.0 * step)
    drawn = determinant_slopes(window, unknowns, 40)[0, 0]
    assert drawn == pytest.approx(dense, rel=0.15)
    # A fit does not depend on those that are computed with it.
    beside = replace(start, middle=(middle[0] + 1, middle[1]))
    both = object_window.ObjectWindow.of(prepared, decoder.layer_optics, [beside, start])
    assert determinant_slopes(both, np.vstack([unknowns, unknowns]), 40)[1, 0] == pytest.approx(drawn, rel=1e-6)
