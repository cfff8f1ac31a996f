"""Fisher information of a point source, plain spiral over lens: the edge of the "two orders of magnitude"."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.information.texture import PointSource, Texture
from metafab.phase import Pupil, compare_masks
from metafab.phase.studies.compare import reference_masks

FOCUS_M, RADIUS_UM, WAVELENGTH_UM, IMAGE_UM = 0.30, 1000.0, 0.8, 21429.0
PUPIL = Pupil(64)


def test_the_edge_of_the_two_orders_of_magnitude() -> None:
    """Ratio of the information, spiral over lens: above 100 within 0.02 dioptre of focus, below 2 from 0.2 on."""
    away = np.array([0.005, 0.02, 0.03, 0.2, 0.5])
    bounds = compare_masks(
        reference_masks(PUPIL, 4, 0.5), PUPIL, 1.0 / (1.0 / FOCUS_M - away), focus_depth_m=FOCUS_M,
        aperture_um=2.0 * RADIUS_UM, wavelength_um=WAVELENGTH_UM, source=PointSource(), texture=Texture(),
    )  # fmt: skip
    ratio = (bounds.point_m[0] / bounds.point_m[1]) ** 2
    assert (np.diff(ratio) < 0.0).all()
    assert ratio[1] > 100.0 > ratio[2]
    assert ratio[3] < 2.0 and ratio[4] < 1.0
    # Near focus a lens' blur is of second order: its information grows with the square of the distance.
    assert ratio[0] / ratio[1] == pytest.approx(16.0, rel=0.02)
