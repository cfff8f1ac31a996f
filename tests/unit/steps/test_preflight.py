"""Checks before any step runs: each wavelength of a design counts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from metafab.core.errors import InputError
from metafab.spec import Light, load_design
from metafab.steps.job import Job
from metafab.steps.preflight import PREFLIGHT, PreflightFigures
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
