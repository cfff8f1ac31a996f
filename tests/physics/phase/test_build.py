"""A design's phase terms, optimised as its file says."""

from __future__ import annotations

import dataclasses

import pytest

from metafab.core.errors import InputError
from metafab.phase import Pupil, main_lobe, optimise_peak, profile_of
from metafab.phase.pupil import pupil_field
from metafab.spec import Design
from metafab.spec.terms import SpiralZones


def test_profiles_of_a_design_optimise_as_their_file_says(small_design: Design) -> None:
    figures = profile_of(small_design).figures
    assert figures.peak_gain >= 1.36
    assert figures.bound_fraction > 0.95
    # The small lens turns as the paper's does between 25 and 34 cm: 1.06 dioptre of 56 degrees at R = 1 mm.
    assert figures.rotation_deg == pytest.approx(56.25 * (4.0 - 1.0 / 0.34), rel=0.1)
    assert figures.rotation_deg_per_dioptre == pytest.approx(figures.rotation_deg_per_dioptre_theory, rel=0.1)
    spiral = small_design.phase[0]
    gains = {}
    for wish in ("none", "worst_peak", "blind_information"):
        terms = (dataclasses.replace(spiral, optimise=wish), *small_design.phase[1:])  # type: ignore[arg-type]
        gains[wish] = profile_of(dataclasses.replace(small_design, phase=terms)).figures
    assert gains["none"].peak_gain == 1.0
    assert gains["worst_peak"].worst_gain >= 1.5
    assert gains["blind_information"].blind_information_gain >= 1.4


PUPIL = Pupil(48)


def test_a_design_may_ask_for_it(small_design: Design) -> None:
    plain = small_design.phase[0]
    assert isinstance(plain, SpiralZones)
    spiral = dataclasses.replace(plain, optimise="peak", side_lobe_limit=0.35)
    design = dataclasses.replace(small_design, phase=(spiral, *small_design.phase[1:]))
    profile = profile_of(design)
    assert profile.figures.side_lobe <= 0.35 < profile.figures.side_lobe_without_limit
    fine = Pupil(128)
    field = pupil_field(profile.terms[0], fine, 0.5 * design.device.aperture_um)
    lobe = main_lobe(fine, field, optimise_peak(4, pupil=PUPIL).defocus_rad, 14.0)
    # Between the samples the field is interpolated: some light is lost, none of the turning.
    assert lobe.peak.mean() == pytest.approx(profile.figures.peak_mean, rel=0.03)


def test_a_limit_that_no_mask_keeps_is_a_fault_of_the_design(
    small_design: Design, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The refusal itself is tested with the optimiser."""

    def refuse(*_: object, **__: object) -> None:
        raise ValueError("`limit`: expected at least about 0.2, the lowest met, got 0.01")

    monkeypatch.setattr("metafab.phase.build.limit_side_lobes", refuse)
    spiral = dataclasses.replace(small_design.phase[0], optimise="peak", side_lobe_limit=0.01)  # type: ignore[call-arg]
    numerics = dataclasses.replace(small_design.numerics, iterations=1)
    with pytest.raises(InputError, match=r"`phase\.side_lobe_limit`: expected a limit that some mask keeps, got 0\.01"):
        profile_of(dataclasses.replace(small_design, phase=(spiral, *small_design.phase[1:]), numerics=numerics))


def test_the_limit_goes_with_the_peak() -> None:
    with pytest.raises(ValueError, match="side_lobe_limit"):
        SpiralZones(optimise="blind_information", side_lobe_limit=0.3)
