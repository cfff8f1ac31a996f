"""Masks that the tests of layout, mask and drc share."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from metafab import layout, mask
from metafab.core.conventions import FloatArray, Polarisation
from metafab.layout import Assignment, PillarMap
from metafab.library import Library
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Design


@dataclass(frozen=True)
class OffAxisLens:
    """Both polarisations to points on either side of the axis; in closed form, for tests of the layout only."""

    focal_um: float
    wavelength_um: float
    shift_um: float

    def __call__(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        shift = self.shift_um if polarisation == "x" else -self.shift_um
        path = np.sqrt((x_um[None, :] + shift) ** 2 + y_um[:, None] ** 2 + self.focal_um**2)
        return -2.0 * np.pi / self.wavelength_um * path


@pytest.fixture(scope="session")
def profile() -> PhaseProfile:
    return PhaseProfile((OffAxisLens(1000.0, 0.8, 140.0),))


@pytest.fixture(scope="session")
def tiny_design(small_design: Design) -> Design:
    """Forty micrometres across, in tiles of 34 sites: some thirteen thousand pillars, several tiles."""
    return replace(
        small_design,
        device=replace(small_design.device, aperture_um=40.0),
        numerics=replace(small_design.numerics, tile_sites=34),
    )


@pytest.fixture(scope="session")
def tiny(profile: PhaseProfile, smooth_library: Library, tiny_design: Design) -> Assignment:
    return layout.assign(profile, smooth_library, tiny_design)


@pytest.fixture(scope="session")
def tiny_files(tiny: Assignment, tiny_design: Design, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The written mask by suffix."""
    folder = tmp_path_factory.mktemp("tiny")
    return {file.path.suffix[1:]: file.path for file in mask.write(tiny.pillars, folder, tiny_design)}


def sizes_at_sites(pillars: PillarMap) -> np.ndarray:
    """(width, length) in dbu at every site: what two maps must agree in, however their tables are ordered."""
    return pillars.size_dbu[pillars.to_array()]
