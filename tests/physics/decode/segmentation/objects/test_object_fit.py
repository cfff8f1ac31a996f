"""A small object's depth by the model of both images: unbiased, with an honest error, from a rough start."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.camera import capture
from metafab.decode.decoder import Decoder
from metafab.decode.segmentation.objects.object_fit import FittedObject, fitted_objects
from metafab.decode.segmentation.objects.object_solver import LinearModel
from metafab.decode.segmentation.objects.object_window import ObjectStart
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf

WALL_M, OBJECT_M, SIDE = 0.0034, 0.0027, 0.03


def fitted(seed: int, contrast: float, start_ratio: float) -> tuple[FittedObject | None, float]:
    """The fit from a start off by a pixel and by a ratio in depth, and the true half side in downsampled pixels."""
    psf = helix_psf(1.0 / np.linspace(1 / 0.0038, 1 / 0.0024, 13))
    things = (
        SceneObject(depth_m=WALL_M, size=(0.6, 0.6)),
        SceneObject(depth_m=OBJECT_M, size=(SIDE, SIDE), polarisation_contrast=contrast),
    )
    frame = capture(Scene(objects=things, photons_per_pixel=3000.0, field_px=(260, 165), seed=seed), psf)
    decoder = Decoder.of(psf, frame.frame.shape, frame.origin_um, frame.x_window)
    assert decoder is not None
    prepared = decoder.prepare(replace(frame, truth=None))
    assert not isinstance(prepared, str)
    step, grid = prepared.downsampling.step, decoder.calibration.grid
    inside = slice(grid.margin, -grid.margin)
    away = np.hypot(grid.tangent_x[inside, inside], grid.tangent_y[inside, inside])
    row, column = (int(place) // step for place in np.unravel_index(away.argmin(), away.shape))
    half = 0.5 * SIDE * psf.sensor_distance_um / psf.pixel_um / step
    rectangle = np.array([0.5, -0.5, half + 0.5, half - 0.3])
    start = ObjectStart((row, column), 20, 1.0 / WALL_M, np.ones(2), start_ratio / OBJECT_M, rectangle)
    return fitted_objects(prepared, decoder.layer_optics, [start])[0], half


@pytest.mark.parametrize("contrast", [0.5, 2.0])
def test_the_depth_is_right_from_a_rough_start(contrast: float, monkeypatch: pytest.MonkeyPatch) -> None:
    solved, rounds = LinearModel.solved, []
    monkeypatch.setattr(LinearModel, "solved", lambda *given: rounds.append(1) or solved(*given))
    near, half = fitted(4, contrast, 1.06)
    assert len(rounds) <= 10  # 24, and unsettled, with steps that undo each other at a contrast of 2
    far, _ = fitted(4, contrast, 0.94)
    assert near is not None and far is not None
    error = OBJECT_M * near.vergence_per_m - 1.0
    assert abs(error) < 3.0 * near.relative_error < 0.06
    assert near.vergence_per_m == pytest.approx(far.vergence_per_m, rel=0.5 * near.relative_error)
    assert near.rectangle[2:] == pytest.approx([half, half], abs=0.25)


def test_a_start_beyond_the_surface_has_no_object() -> None:
    assert fitted(4, 2.0, 0.7)[0] is None
