"""Study of a design's phases: its parts, and the mask without carriers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.phase import Pupil, profile_of, study
from metafab.phase.pupil import FocalPlane
from metafab.phase.studies.study import mask_field
from metafab.phase.terms.helices import spiral_field
from metafab.spec import Design
from metafab.spec.device import Optics
from metafab.spec.terms import SpiralZones

PUPIL = Pupil(32)


def _plain(design: Design) -> Design:
    spiral = design.phase[0]
    assert isinstance(spiral, SpiralZones)
    return replace(design, phase=(replace(spiral, optimise="none"), *design.phase[1:]))


def test_a_study_has_what_the_design_declares(small_design: Design) -> None:
    design = _plain(small_design)
    profile = profile_of(design)
    without = study(design, profile)
    assert without.bandwidth is None and without.lobe is not None and without.bounds is not None
    assert without.bounds.masks[0] == "this design"
    np.testing.assert_array_equal(without.bounds.texture_m[0], without.bounds.texture_m[2])  # it is the plain spiral
    np.testing.assert_array_equal(without.lobe.design.peak, without.lobe.plain.peak)
    assert without.bounds.depth_m[0] == pytest.approx(design.depths_m[0])
    assert without.bounds.depth_m[-1] == pytest.approx(design.depths_m[-1])
    budget = study(replace(design, optics=Optics(10.0)), profile).bandwidth
    assert budget is not None and budget.fwhm_nm == 10.0


def test_a_design_without_helix_or_split_has_no_lobe_and_no_budget(small_design: Design) -> None:
    split = small_design.phase[1]
    lens = replace(small_design, phase=(split,), optics=Optics(10.0))
    result = study(lens, profile_of(lens))
    assert result.lobe is None and result.bounds is not None and result.bandwidth is not None
    assert not np.isfinite(result.bounds.texture_m[0]).any(), "a lens has no information"
    helix = replace(_plain(small_design), optics=Optics(10.0))
    helix = replace(helix, phase=helix.phase[:1])
    assert study(helix, profile_of(helix)).bandwidth is None, "nothing is split"


def test_masks_leave_the_carriers_out(small_design: Design) -> None:
    design = _plain(small_design)
    field = mask_field(profile_of(design), PUPIL, 0.5 * design.device.aperture_um)
    np.testing.assert_allclose(field[0], spiral_field(PUPIL, 4, 0.5), atol=1e-12)
    grid = np.zeros((2, *PUPIL.inside.shape), dtype=complex)
    grid[:, PUPIL.inside] = field
    np.testing.assert_allclose(grid[1], grid[0, ::-1, ::-1], atol=1e-12)
    assert FocalPlane(PUPIL, 3.0).psf(field[0], [0.0]).max() <= 1.0
