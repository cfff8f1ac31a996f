"""Warnings of the light at several wavelengths."""

from __future__ import annotations

from dataclasses import replace

from metafab.steps.optics import PairFigures
from metafab.steps.optics.lights import LightFigures, LightsFigures
from tests.closed_form_run import turning_psf


def test_the_wavelength_whose_light_misses_the_window_is_named() -> None:
    pair = PairFigures.of(turning_psf())
    missed = replace(pair, light_at_um=((12.0, 0.0), (12.0, 0.0)))
    lights = [LightFigures(nm, "psf.h5", at, (0.9,), (0.9,)) for nm, at in ((460.0, pair), (632.8, missed))]
    (warning,) = LightsFigures(tuple(lights)).warnings()
    assert warning.startswith("at 632.8 nm the window misses the light") and "(12, 0)" in warning
