"""From target phases to pillars: the best sizes, the same at every tiling, never below the gap."""

from __future__ import annotations

import sys
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any, Literal

import numpy as np
import pytest

from metafab import layout
from metafab.core.conventions import FloatArray, Polarisation, wrap_phase
from metafab.core.errors import InputError
from metafab.core.parallel.executor import SerialExecutor
from metafab.layout import Aperture, Assignment, PillarMap
from metafab.layout.assign import wave_plate
from metafab.layout.gap_rule import allowed_sizes
from metafab.library import Library
from metafab.library.neighbours import LineStatistics, Neighbours, TrainedLine
from metafab.library.neighbours.line import LineShape, initial_model
from metafab.library.neighbours.mask.choice import NeighbourChoice
from metafab.optics import neighbour_field
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Design
from metafab.spec.design import Numerics
from tests.layout.conftest import sizes_at_sites


def test_exactly_the_sites_inside_the_aperture_carry_a_pillar(tiny: Assignment, tiny_design: Design) -> None:
    aperture = Aperture.of(tiny_design)
    assert np.array_equal(tiny.pillars.to_array() > 0, aperture.inside(0, 0, aperture.lattice.shape))
    assert tiny.figures.pillars == aperture.count


def test_a_notebook_shows_the_mapping_with_its_pillars(tiny: Assignment) -> None:
    html = tiny._repr_html_()
    assert "<img" in html
    assert f"{tiny.figures.efficiency:.3f}" in html


def test_figures_are_what_a_direct_sum_over_the_pillars_gives(
    tiny: Assignment, profile: PhaseProfile, smooth_library: Library, tiny_design: Design
) -> None:
    lattice, index = tiny.pillars.lattice, tiny.pillars.to_array()
    width, length = np.moveaxis(tiny.pillars.size_nm()[index[index > 0]], -1, 0)
    reached = smooth_library.at_sizes(width, length)
    target = profile(lattice.x_um(), lattice.y_um())[:, index > 0] + np.reshape(tiny.offsets_rad, (2, 1))
    square = 0.0
    for t, wanted, name in zip((reached.t_xx, reached.t_yy), target, "xy", strict=True):
        error = wrap_phase(np.angle(t) - wanted)
        overlap = abs(np.sum(t * np.exp(-1j * wanted))) ** 2 / (wanted.size * np.sum(np.abs(t) ** 2))
        # 1e-9: the same float64 terms in another order.
        assert getattr(tiny.figures, f"field_overlap_{name}") == pytest.approx(overlap, rel=1e-9)
        square += np.mean(error**2) / 2
    assert tiny.figures.phase_rms_error_rad == pytest.approx(np.sqrt(square), rel=1e-9)


def test_no_other_size_would_overlap_much_better(
    tiny: Assignment, profile: PhaseProfile, smooth_library: Library, tiny_design: Design
) -> None:
    """The look-up's cells are 2 pi / 512 wide, so a choice may lose the overlap of half a cell: |t| (pi/512) each."""
    table = allowed_sizes(smooth_library, tiny_design)
    lattice, index = tiny.pillars.lattice, tiny.pillars.to_array()
    row = lattice.shape[0] // 2
    target = profile(lattice.x_um(), lattice.y_um()[row : row + 1])[:, 0] + np.reshape(tiny.offsets_rad, (2, 1))
    overlap = np.real(table.t @ np.exp(-1j * target))
    chosen = overlap[index[row], np.arange(index.shape[1])]
    inside = index[row] > 0
    largest = np.abs(table.t).max()
    assert np.all((overlap[1:].max(axis=0) - chosen)[inside] <= 2 * largest * np.sqrt(2) * np.pi / 512)


@dataclass(frozen=True)
class WavePlate:
    """A lens that retards y polarisation by a constant phase, in single precision as in a file of phases."""

    retardance_rad: float

    def __call__(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        path = np.sqrt(x_um[None, :] ** 2 + y_um[:, None] ** 2 + 200.0**2)
        phase = -2.0 * np.pi / 0.8 * path + (self.retardance_rad if polarisation == "y" else 0.0)
        return phase.astype(np.float32).astype(np.float64)


@pytest.mark.parametrize(
    ("retardance_rad", "rule", "kept"),
    [(np.pi, "auto", True), (np.pi, "free", False), (0.0, "auto", False), (0.0, "kept", True)],
)
def test_a_wave_plate_keeps_its_retardance(
    retardance_rad: float,
    rule: Literal["auto", "kept", "free"],
    kept: bool,
    smooth_library: Library,
    tiny_design: Design,
) -> None:
    """Retardance of the chosen pillars, by their t directly; one constant serves both polarisations where it is kept.

    0.1 rad: targets cover all phases, which the library's sizes reach to within 0.3 rad without a common sign.
    """
    design = replace(tiny_design, rules=replace(tiny_design.rules, retardance=rule))
    found = layout.assign(PhaseProfile((WavePlate(retardance_rad),)), smooth_library, design)
    assert (found.offsets_rad[0] == found.offsets_rad[1]) == kept
    index = found.pillars.to_array()
    t = smooth_library.at_sizes(*np.moveaxis(found.pillars.size_nm()[index[index > 0]], -1, 0))
    reached = np.angle(np.mean(t.t_yy * t.t_xx.conj()))
    error = found.figures.retardance_error_rad
    assert error is not None
    # Mean of products against product of means: second order in phase errors.
    assert abs(wrap_phase(reached - retardance_rad - error)) < 0.1
    if kept:
        assert abs(error) < 0.1


def test_phases_that_vary_are_no_wave_plate_from_their_first_line() -> None:
    """The lines of the sample after it are not evaluated."""
    lines = iter([np.array([[0.0, 0.0], [0.0, 1.0]]), np.zeros((2, 2))])
    assert wave_plate(lines) is None
    assert len(list(lines)) == 1


def test_squares_are_no_wave_plate(smooth_library: Library, tiny_design: Design) -> None:
    design = replace(tiny_design, rules=replace(tiny_design.rules, polarisation_independent=True))
    with pytest.raises(InputError, match=r"respond equally.*retardance of -?3.14 rad.*rectangles or ellipses"):
        layout.assign(PhaseProfile((WavePlate(np.pi),)), smooth_library, design)


@pytest.mark.parametrize("tile_sites", [17, 51, 476])
def test_tiling_and_workers_change_nothing(
    tile_sites: int, tiny: Assignment, profile: PhaseProfile, smooth_library: Library, tiny_design: Design
) -> None:
    design = replace(tiny_design, numerics=replace(tiny_design.numerics, tile_sites=tile_sites))
    with ThreadPoolExecutor(3) as threads:
        other = layout.assign(profile, smooth_library, design, executor=threads)
    assert np.array_equal(other.pillars.to_array(), tiny.pillars.to_array())
    assert other.figures.min_gap_nm == tiny.figures.min_gap_nm
    assert other.figures.phase_rms_error_rad == pytest.approx(tiny.figures.phase_rms_error_rad, rel=1e-12)


def test_a_lens_too_large_to_keep_is_mapped_again_on_each_reading(
    tiny: Assignment,
    profile: PhaseProfile,
    smooth_library: Library,
    tiny_design: Design,
) -> None:
    streamed = layout.assign(profile, smooth_library, tiny_design, kept_sites=100)
    assert streamed.figures == tiny.figures
    for _ in range(2):
        assert np.array_equal(streamed.pillars.to_array(), tiny.pillars.to_array())


def test_sizes_are_the_librarys(tiny: Assignment, smooth_library: Library) -> None:
    size_nm = sizes_at_sites(tiny.pillars).reshape(-1, 2) * 0.5
    used = np.unique(size_nm[size_nm[:, 0] > 0], axis=0)
    assert len(used) == tiny.figures.distinct_sizes
    smooth_library.at_sizes(used[:, 0], used[:, 1])  # raises where a size is not in the library


def _coupled(library: Library, strength: float) -> Library:
    """A library with chains of random parameters whose modes radiate ``strength`` times as much."""

    def line(seed: int) -> TrainedLine:
        model = initial_model(LineShape(2, 1, 2), (100.0, 250.0), (100.0, 250.0), seed)
        return TrainedLine(replace(model, own=strength * model.own, side=strength * model.side), LineStatistics())

    along, across = line(1), line(2)
    return replace(library, neighbours=Neighbours((along, along), (across, across)))


@pytest.fixture(scope="module")
def coupled_library(smooth_library: Library) -> Library:
    """Chains with light enough in them to change the field by a tenth."""
    return _coupled(smooth_library, 6.0)


def _light_of_mask(profile: PhaseProfile, library: Library, found: Assignment, pillars: PillarMap) -> float:
    """Share of light in the wanted wave, by the field of the mask, which another room computes."""
    lattice = pillars.lattice
    target = profile(lattice.x_um(), lattice.y_um()) + np.reshape(found.offsets_rad, (2, 1, 1))
    sums = np.zeros(2, dtype=np.complex128)
    for tile in neighbour_field(pillars, library).tiles():
        n_y, n_x = tile.amplitude(0).shape
        here = np.exp(-1j * target[:, tile.row : tile.row + n_y, tile.column : tile.column + n_x])
        sums += [np.sum(here[axis] * tile.amplitude(axis)) for axis in (0, 1)]
    return float(np.mean(np.abs(sums / np.count_nonzero(pillars.to_array())) ** 2))


class _Recording(SerialExecutor):
    """Notes the names of the functions that it runs."""

    def __init__(self) -> None:
        self.names: list[str] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        function = fn.func if isinstance(fn, partial) else fn
        self.names.append(getattr(function, "__name__", ""))
        return super().submit(fn, *args, **kwargs)


def test_sizes_chosen_among_neighbours_send_more_light_to_the_target(
    profile: PhaseProfile,
    smooth_library: Library,
    coupled_library: Library,
    tiny_design: Design,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # 3700 pillars, in four tiles: each choice among neighbours takes seconds for the lens of the other tests.
    design = replace(tiny_design, device=replace(tiny_design.device, aperture_um=24.0))
    alone = layout.assign(profile, smooth_library, design)
    asked = replace(design, rules=replace(design.rules, neighbours=True))
    found = layout.assign(profile, coupled_library, replace(asked, numerics=Numerics(tile_sites=476)))
    figures, index = found.figures, found.pillars.to_array()
    efficiency = partial(_light_of_mask, profile, coupled_library, found)
    assert alone.figures.neighbour_efficiency is None

    assert figures.neighbour_efficiency == pytest.approx(efficiency(found.pillars), rel=1e-4)
    assert figures.neighbour_efficiency_before == pytest.approx(efficiency(alone.pillars), rel=1e-4)
    assert figures.neighbour_efficiency > figures.neighbour_efficiency_before + 0.2 * (
        alone.figures.efficiency - figures.neighbour_efficiency_before
    )
    assert np.array_equal(index > 0, alone.pillars.to_array() > 0)
    assert figures.min_gap_nm is not None
    assert figures.min_gap_nm >= asked.rules.min_gap_nm
    assert figures.neighbour_phase_rms_error_rad is not None
    assert figures.neighbour_phase_rms_error_before_rad is not None
    assert figures.neighbour_phase_rms_error_rad < max(0.03, figures.neighbour_phase_rms_error_before_rad)
    # Phase errors are carried along rows, so that tiles choose other sizes; their light is as much.
    tiled = layout.assign(profile, coupled_library, asked)
    assert efficiency(tiled.pillars) == pytest.approx(figures.neighbour_efficiency, abs=5e-3)
    assert tiled.figures.neighbour_efficiency == pytest.approx(efficiency(tiled.pillars), rel=1e-3)
    # By the table, from eight windows of the mask; eight others state its light.
    monkeypatch.setattr(sys.modules[Assignment.__module__], "_WINDOW_SITES", 32)
    by_table, asked_of = replace(asked, rules=replace(asked.rules, neighbours="table")), _Recording()
    table = layout.assign(profile, coupled_library, by_table, executor=asked_of)
    assert asked_of.names.count("phase_shifts") == asked_of.names.count("sampled") == 8
    light, light_before = efficiency(table.pillars), efficiency(alone.pillars)
    assert light - light_before > (efficiency(tiled.pillars) - light_before) / 3.0
    sampled = table.figures
    assert sampled.pillars == figures.pillars
    assert sampled.neighbour_efficiency == pytest.approx(light, abs=3e-3)
    assert sampled.neighbour_efficiency_before == pytest.approx(light_before, abs=3e-3)
    assert sampled.neighbour_efficiency > sampled.neighbour_efficiency_before
    assert sampled.neighbour_phase_rms_error_before_rad == pytest.approx(
        figures.neighbour_phase_rms_error_before_rad, rel=0.1
    )


def test_light_beyond_the_incident_one_is_scaled_as_in_a_psf(
    profile: PhaseProfile, smooth_library: Library, tiny_design: Design
) -> None:
    """Chains so strong that their field carries more power than arrives: 0.79 of it in the wanted wave, unscaled."""
    strong = _coupled(smooth_library, 60.0)
    rules = replace(tiny_design.rules, neighbours=True)
    asked = replace(tiny_design, rules=rules, numerics=Numerics(tile_sites=476))
    found = layout.assign(profile, strong, asked)
    light = _light_of_mask(profile, strong, found, found.pillars)
    assert found.figures.neighbour_efficiency == pytest.approx(light, rel=1e-4)
    assert light < 0.7 * found.figures.efficiency


@pytest.mark.parametrize("target_rad", [0.0, 0.4])
def test_moves_among_neighbours_hold_the_local_phase(coupled_library: Library, target_rad: float) -> None:
    """Sizes start ``target_rad`` off; the mean over 30 pillars ends closer than one step of the grid moves a pillar."""
    size_nm = np.array([(0.0, 0.0), *product(np.arange(100.0, 251.0, 2.0), repeat=2)])
    known = coupled_library.surface(np.maximum(size_nm[:, 0], 100.0), np.maximum(size_nm[:, 1], 100.0))
    assert coupled_library.neighbours is not None
    choice = NeighbourChoice.of(coupled_library.neighbours, size_nm, np.stack([known.t_xx, known.t_yy], axis=1))
    ramp = np.random.default_rng(1).uniform(-np.pi, np.pi, (2, 8, 1)) + np.array([0.4, -0.3])[
        :, None, None
    ] * np.arange(90)
    lone = np.exp(-1j * (ramp - target_rad)[..., None]) * choice.t[1:].T[:, None, None]
    size_index = (1 + lone.real.sum(axis=0).argmax(axis=-1)).astype(np.uint16)
    before, after = choice.improve(size_index, ramp)
    middle = np.s_[:, :, 30:60]
    held = np.angle(after[middle].mean(axis=2))
    assert after[middle].real.mean() > before[middle].real.mean()
    assert np.sqrt(np.mean(held**2)) < 0.05


def test_a_choice_among_neighbours_needs_their_model(
    profile: PhaseProfile, smooth_library: Library, tiny_design: Design
) -> None:
    asked = replace(tiny_design, rules=replace(tiny_design.rules, neighbours=True))
    with pytest.raises(InputError, match="a model of neighbours"):
        layout.assign(profile, smooth_library, asked)
    with pytest.raises(ValueError, match='goes with `gap_rule = "each"`'):
        replace(asked.rules, gap_rule="pairs")
    for number in (0, 1, 1.0):
        with pytest.raises(InputError, match=rf'`neighbours`: expected false, true or "table", got {number}$'):
            replace(asked.rules, neighbours=number)
