"""Checks before any step runs: each wavelength of a design counts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab.core.errors import InputError
from metafab.spec import Light, load_design, terms
from metafab.steps.job import Job
from metafab.steps.preflight import PREFLIGHT, PreflightFigures, too_steep
from tests.main_job import ROOT


def announced(wavelength_nm: float, folder: Path) -> tuple[str, ...]:
    design = load_design(ROOT / "layouts" / "rgb_metalens.toml")
    light = (Light(wavelength_nm), Light(540.0))
    figures = PREFLIGHT.work(Job(replace(design, light=light), folder))
    assert isinstance(figures, PreflightFigures)
    return figures.announcements


def test_orders_that_open_at_one_of_the_wavelengths_are_announced(tmp_path: Path) -> None:
    """A period of 300 nm sends orders into fused silica below 438 nm."""
    orders = [each for each in announced(420.0, tmp_path) if "diffraction orders" in each]
    assert len(orders) == 1 and orders[0].startswith("at 420 nm, 4 diffraction orders")
    assert not [each for each in announced(460.0, tmp_path) if "diffraction orders" in each]


def test_a_wavelength_at_which_a_material_is_not_known_is_refused_before_any_work(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="TiO2"):
        announced(3000.0, tmp_path)


def test_phases_too_steep_for_the_pillars_are_announced(tmp_path: Path) -> None:
    """Pillars 300 nm apart sample directions below asin(lambda / 600 nm): 64 degrees at 540 nm, 50 at 460 nm."""
    design = load_design(ROOT / "layouts" / "rgb_metalens.toml")
    lights = (Light(460.0), Light(540.0))
    for angle_deg, told in ((45.0, []), (55.0, ["460"]), (70.0, ["460", "540"])):
        grating = replace(design, phase=(terms.Grating(angle_deg=angle_deg),), light=lights)
        assert [each.split()[1] for each in too_steep(Job(grating, tmp_path))] == told
    # Of a lens, the places where the direction cosine along x or y exceeds 0.9: none at NA 0.83.
    fast = replace(design, device=replace(design.device, focal_length_mm=0.008), light=(), phase=(terms.Lens(),))
    assert too_steep(Job(fast, tmp_path)) == []
    faster = replace(fast, device=replace(design.device, focal_length_mm=0.004))
    steep, radius = 0.9, 3.0  # The radius is that over the focal length.
    x = (np.arange(4000) + 0.5) / 4000 * radius
    inside = x[:, None] ** 2 + x**2 < radius**2
    root = np.sqrt(1.0 + x[:, None] ** 2 + x**2)
    share = ((x / root > steep) | (x[:, None] / root > steep))[inside].mean()
    (sentence,) = too_steep(Job(faster, tmp_path))
    assert float(sentence.split(" % ")[0].split()[-1]) == pytest.approx(100.0 * share, rel=0.02)
