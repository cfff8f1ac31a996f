"""A PSF pair that cannot be computed is refused before its mask is read."""

from __future__ import annotations

from pathlib import Path

import pytest

from metafab.core.errors import InputError
from metafab.spec import Design
from metafab.steps.job import Job
from metafab.steps.optics import WrittenLens, point_spread


def test_coarse_pixels_are_refused_before_the_mask_is_read(small_design: Design, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="finest fringe"):
        point_spread(Job(small_design, tmp_path), WrittenLens(tmp_path / "gone.oas"), pixel_um=50.0)
