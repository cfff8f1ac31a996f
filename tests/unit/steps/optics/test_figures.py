"""Sentences on windows that hold little of the light."""

from __future__ import annotations

from dataclasses import replace

import pytest

from metafab.steps.optics.figures import PairFigures


def figures(efficiency: float, *, peak_on_edge: bool = False) -> PairFigures:
    return PairFigures(
        depth_m=(1.0, 2.0, 3.0),
        phi_deg=(0.0,) * 3,
        efficiency_x=(0.9, efficiency, 0.9),
        efficiency_y=(0.9, 0.7, 0.9),
        extinction_ratio=(100.0,) * 3,
        error=(1e-4,) * 3,
        transmitted_x=0.9,
        transmitted_y=0.9,
        peak_on_edge=peak_on_edge,
    )


@pytest.mark.parametrize(("efficiency", "is_told"), [(0.5, False), (0.05, False), (0.009, True), (0.0, True)])
def test_a_spot_far_wider_than_its_window_is_told(efficiency: float, is_told: bool) -> None:
    """At the middle depth, by the polarisation of which the window holds less."""
    warnings = figures(efficiency).warnings()
    assert bool(warnings) == is_told
    if is_told:
        assert f"the window holds {100.0 * efficiency / 0.9:.2g} % of the transmitted light" in warnings[0]


def test_a_cut_image_is_told_once() -> None:
    (warning,) = figures(0.009, peak_on_edge=True).warnings()
    assert "lies on the edge of the window, which holds 1 % of" in warning


def test_a_key_that_a_splitting_lens_refuses_is_offered_to_the_others_alone() -> None:
    """`metafab psf --centre-um` serves every design."""
    elsewhere = replace(figures(0.5), light_at_um=((1.0, 2.0), (3.0, 4.0)))
    for found in (elsewhere, figures(0.009, peak_on_edge=True)):
        (warning,) = found.warnings()
        assert "`metafab psf --centre-um X Y` or, in a design without scene and `split_lens`" in warning


@pytest.mark.parametrize(("made_error", "is_told"), [(None, False), (0.05, False), (0.357, True)])
def test_made_pillars_of_hardly_known_light_are_told(made_error: float | None, is_told: bool) -> None:
    warnings = replace(figures(0.5), made_error=made_error).warnings()
    assert bool(warnings) == is_told
    if is_told:
        assert "known to 36 % (rms)" in warnings[0]
