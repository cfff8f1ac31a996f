"""One mask for two wavelengths: better at both than lenses for either, and the same whatever the tiles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab import layout
from metafab.core.errors import InputError
from metafab.layout.mapping import LightTarget
from metafab.library import Library
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Design, Light, Numerics
from tests.layout.conftest import OffAxisLens, sizes_at_sites

SECOND_NM = 650.0


@pytest.fixture(scope="module")
def design(tiny_design: Design) -> Design:
    return replace(tiny_design, light=(Light(SECOND_NM, weight=1.5), Light(800.0)))


@pytest.fixture(scope="module")
def first(smooth_library: Library) -> Library:
    """Every fifth width and length of the smooth library."""
    whole = smooth_library
    names = ("t_xx", "t_yy", "r_xx", "r_yy", "error")
    return replace(
        whole,
        width_nm=whole.width_nm[::5],
        length_nm=whole.length_nm[::5],
        **{name: getattr(whole, name)[:, ::5, ::5] for name in names},
    )


@pytest.fixture(scope="module")
def second(first: Library) -> Library:
    """The library at the second wavelength: twice the phases."""
    cell = first.unit_cell
    light = replace(cell.illumination, wavelength_nm=SECOND_NM)
    t_xx, t_yy = (np.abs(t) * (t / np.abs(t)) ** 2 for t in (first.t_xx, first.t_yy))
    return replace(first, unit_cell=replace(cell, illumination=light), t_xx=t_xx, t_yy=t_yy)


@pytest.fixture(scope="module")
def targets(profile: PhaseProfile, first: Library, second: Library) -> list[LightTarget]:
    """In the order of ``design.light``."""
    of_second = PhaseProfile((OffAxisLens(1000.0, 1e-3 * SECOND_NM, 140.0),))
    return [LightTarget(of_second, second, 1.5), LightTarget(profile, first, 1.0)]


def test_a_mask_for_two_wavelengths_serves_both_better_than_lenses_for_one(
    profile: PhaseProfile, first: Library, design: Design, targets: list[LightTarget]
) -> None:
    both = layout.assign(profile, first, design, lights=targets)
    assert [light.wavelength_nm for light in both.lights] == [SECOND_NM, 800.0]
    assert [light.weight for light in both.lights] == [1.5, 1.0]
    assert both.lights[1].figures == both.figures
    assert both.lights[1].offsets_rad == both.offsets_rad
    shared = [light.figures.efficiency for light in both.lights]
    assert min(shared) > 0.35
    for number, target in enumerate(targets):
        own = replace(design, light=(), unit_cell=target.library.unit_cell)
        alone = layout.assign(target.profile, target.library, own)
        other = targets[1 - number]
        sizes = alone.pillars.to_array()
        width_nm, length_nm = alone.pillars.size_nm()[1:].T
        found = other.library.at_sizes(width_nm, length_nm)
        lattice = alone.pillars.lattice
        wanted = other.profile(lattice.x_um(), lattice.y_um())
        inside = sizes > 0
        overlaps = []
        for t, phase_rad in zip((found.t_xx, found.t_yy), wanted, strict=True):
            field = t[sizes[inside] - 1]
            overlaps.append(np.abs(np.mean(field * np.exp(-1j * phase_rad[inside]))) ** 2)
        at_other = float(np.mean(overlaps)) / 1.76
        # A lens for one wavelength is better there, and useless at the other.
        assert alone.figures.efficiency > shared[number]
        assert at_other < 0.1
    assert both.to_json()["lights"][0]["figures"]["efficiency"] == pytest.approx(shared[0])


def test_sizes_for_two_wavelengths_do_not_depend_on_tiles(
    profile: PhaseProfile, first: Library, design: Design, targets: list[LightTarget]
) -> None:
    tiled, whole = (
        layout.assign(profile, first, replace(design, numerics=Numerics(tile_sites=n)), lights=targets)
        for n in (34, 476)
    )
    assert np.array_equal(sizes_at_sites(tiled.pillars), sizes_at_sites(whole.pillars))
    assert tiled.lights[0].figures.efficiency == pytest.approx(whole.lights[0].figures.efficiency, rel=1e-9)


def test_libraries_and_lights_of_another_design_are_refused(
    profile: PhaseProfile, first: Library, second: Library, design: Design, targets: list[LightTarget]
) -> None:
    """From Python, library and design come apart: a mapping at another wavelength or period would look like any."""
    wider = replace(first.unit_cell, cell=replace(first.unit_cell.cell, period_nm=(400.0, 400.0)))
    plain = replace(design, light=())
    for library, key in ((second, "illumination"), (replace(first, unit_cell=wider), "period_nm")):
        with pytest.raises(InputError, match=rf"`library.unit_cell.*{key}`: expected that of the design"):
            layout.assign(profile, library, plain)
    for lights in ([], targets[:1], [*targets, targets[0]]):
        with pytest.raises(InputError, match=rf"`lights`: expected 2, as many as the design has, got {len(lights)}"):
            layout.assign(profile, first, design, lights=lights)
    with pytest.raises(InputError, match=r"`lights\[0\].library.unit_cell.illumination`"):
        layout.assign(profile, first, design, lights=targets[::-1])
