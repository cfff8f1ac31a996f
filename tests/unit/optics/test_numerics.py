"""What cannot be asked of a PSF stack is refused by its field's name; up to that limit, power adds up."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from metafab.core.errors import InputError
from metafab.optics import Imaging, PsfNumerics, psf
from metafab.spec import Design, Optics
from tests import optics_lens as lens

OPTICS = lens.imaging(aperture_um=40.0)
SOURCE = lens.ideal(OPTICS, lens.eq_3_and_4(OPTICS))
NAN = math.nan


@pytest.mark.parametrize(
    ("field", "asked"),
    [
        ("depths_m", {"depths_m": [NAN]}),
        ("depths_m", {"depths_m": [0.8e-3, NAN]}),
        ("depths_m", {"depths_m": [0.9e-3, 0.8e-3]}),
        ("depths_m", {"depths_m": []}),
        ("target_error", {"target_error": 0.0}),
        ("target_error", {"target_error": 1e-6}),
        ("target_error", {"target_error": NAN}),
        ("target_error", {"target_error": 5e-6, "filter_fwhm_nm": 1.0}),
        ("window_px", {"window_px": 0}),
        ("window_px", {"window_px": 16.5}),
        ("tangent", {"tangent": (NAN, 0.0)}),
        ("field_tangents", {"field_tangents": (np.array([0.1, 0.0]), np.zeros(1))}),
        ("field_tangents", {"field_tangents": (np.array([0.0, NAN]), np.zeros(1))}),
        ("filter_fwhm_nm", {"filter_fwhm_nm": 2000.0}),
        ("filter_fwhm_nm", {"filter_fwhm_nm": -1.0}),
    ],
)
def test_what_cannot_be_answered_is_refused_by_name(field: str, asked: dict[str, Any]) -> None:
    with pytest.raises(InputError) as refused:
        asked = dict(asked)
        numerics = {key: asked.pop(key) for key in ("window_px", "target_error", "filter_fwhm_nm") if key in asked}
        psf(SOURCE, OPTICS, **{"depths_m": [0.9e-3], **asked}, numerics=PsfNumerics(**{"window_px": 16, **numerics}))
    assert field in {fault.field for fault in refused.value.faults}


def test_all_faults_come_at_once() -> None:
    with pytest.raises(InputError) as refused:
        psf(SOURCE, OPTICS, [NAN], PsfNumerics(window_px=0, target_error=0.0))
    assert {fault.field for fault in refused.value.faults} == {"depths_m", "window_px", "target_error"}


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_no_sampling_finds_more_light_than_was_let_through(share: float) -> None:
    """On one window, sampled up to the limit: pixels add up to the same power, and to no more than passes the lens."""
    limit_um = min(OPTICS.finest_fringe_um(p, (0.0, 0.0)) for p in (0, 1))
    assert limit_um == pytest.approx(0.8 * OPTICS.sensor_distance_um / 40.0, rel=0.05)
    coarse = replace(OPTICS, pixel_um=share * limit_um)
    details = psf(SOURCE, coarse, [0.9e-3], PsfNumerics(window_px=2 * round(16 / share))).details
    # What lies outside falls with the width of the window, which is the same for all.
    assert all(0.0 < stray < 0.03 for stray in details.stray)


def test_coarser_pixels_are_refused_with_limit_and_remedy() -> None:
    coarse: Imaging = replace(OPTICS, pixel_um=12.0)
    with pytest.raises(InputError, match=r"`pixel_um`: expected below 9\.01 um.*got 12 um; sample finer"):
        psf(SOURCE, coarse, [0.9e-3], PsfNumerics(window_px=32))


def test_numerics_of_a_design_are_those_of_its_file(small_design: Design) -> None:
    verify = replace(small_design.verify, window_px=48, target_error=2e-3, vectorial=True)
    design = replace(small_design, verify=verify, optics=Optics(filter_fwhm_nm=5.0))
    assert PsfNumerics.of(design) == PsfNumerics(window_px=48, target_error=2e-3, filter_fwhm_nm=5.0, vectorial=True)
    assert PsfNumerics.of(replace(design, optics=None)).filter_fwhm_nm is None


def test_one_depth_in_place_of_a_sequence_is_refused_by_name() -> None:
    with pytest.raises(InputError, match=r"`depths_m`: expected a sequence of depths, such as \[0.0009\], got 0.0009"):
        psf(SOURCE, OPTICS, 0.9e-3)  # type: ignore[arg-type]
