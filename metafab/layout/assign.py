"""Target phases + library + rules -> the pillars of the whole lens, tile by tile."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter
from typing import Any, Generic, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from metafab.core.arguments import require_types
from metafab.core.conventions import FloatArray
from metafab.core.display import Displayed
from metafab.core.errors import Fault, InputError
from metafab.core.figures import LightMapping, MappingFigures
from metafab.core.parallel.executor import AHEAD, default_workers, in_order, one_blas_thread
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.files import plain
from metafab.layout.aperture import Aperture
from metafab.layout.figures import TileSums
from metafab.layout.gap_rule import allowed_sizes, joint_sizes, neighbour_choice
from metafab.layout.geometry import tile_sites
from metafab.layout.mapping import LightChoice, LightTarget, TileMapping
from metafab.layout.outlines import Outline
from metafab.layout.pillars import PillarMap, PillarTile
from metafab.library import Library, SizeTable
from metafab.library.neighbours.mask.choice import SHIFT_CELLS
from metafab.library.use.lights import SizesOfLights
from metafab.library.use.lookup import global_offsets
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Design, UnitCell

Result = TypeVar("Result")

#: Lattices up to this many sites are kept in memory (2 bytes a site); larger ones are mapped again on each reading.
KEPT_SITES = 1 << 27

# Rows and columns that are sampled to choose the constant phases.
_SAMPLED_LINES = 1000
# Golden ratio: its multiples, modulo 1, are spread evenly.
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
# Windows of a mapping by table, and sites per side.
_WINDOWS, _WINDOW_SITES = 8, 208
# Retardances (rad) that differ by less are equal: those of files in single precision, or with three decimals, differ by
# less from place to place.
_SAME_RAD = 1e-2
# Amplitudes of x and y polarisation that differ by less are equal.
_SAME_T = 1e-6


@dataclass(frozen=True, repr=False)
class Assignment(Displayed):
    """The pillars of a lens and how well they follow the target phases."""

    pillars: PillarMap  #: The map.
    figures: MappingFigures  #: Phase error, overlap, transmittance, gap.
    offsets_rad: tuple[float, float]  #: Constants added to the target phases of x and y polarisation.
    #: The figures under ``gap_rule = "each"``, where sizes were chosen jointly; else None.
    gap_rule_each: MappingFigures | None = None
    lights: tuple[LightMapping, ...] = ()  #: The figures at each wavelength, where sizes were chosen for several.

    def key_figures(self) -> dict[str, str]:
        """Pillars, gap and efficiency of the mapping."""
        found = self.figures
        return {
            "pillars": f"{found.pillars} of {found.distinct_sizes} sizes",
            "smallest standing gap": "-" if found.min_gap_nm is None else f"{found.min_gap_nm:g} nm",
            "light in the wanted wave": f"{found.efficiency:.3f}",
            "phase error": f"{found.phase_rms_error_rad:.3f} rad rms",
        }

    def to_json(self) -> dict[str, Any]:
        """The figures as they stand in ``summary.json`` and ``layout.json``."""
        each = {} if self.gap_rule_each is None else {"gap_rule_each": self.gap_rule_each}
        lights = {"lights": self.lights} if self.lights else {}
        table: dict[str, Any] = plain({**plain(self.figures), **each, "offsets_rad": self.offsets_rad, **lights})
        return table


def assign(
    profile: PhaseProfile,
    library: Library,
    design: Design,
    *,
    lights: Sequence[LightTarget] = (),
    executor: Executor | None = None,
    progress: Progress = silent,
    kept_sites: int = KEPT_SITES,
) -> Assignment:
    """Choose the size of every pillar.

    Each site inside the aperture gets the size whose field overlaps best with its two target phases, among those that
    the gap rule allows (:mod:`metafab.layout.gap_rule`). With several lights (``design.light``, in order), the weighted
    sum of their overlaps decides. Profile and library are at the wavelength of the design's unit cell.

    ``executor`` runs tiles; threads of this process by default. It must stay open while the map of a lens of more than
    ``kept_sites`` sites, which is mapped anew on each reading, is read.

    Raises:
        InputError: the library has no size that the rules allow, or another lattice, shape, wavelength or side of
            incidence than the design's unit cell; ``lights`` are not those of the design; or lengths do not fit the
            database unit.
    """
    mapping = mapping_of(profile, library, design, lights, executor)
    table, lattice, corners = mapping.table, mapping.aperture.lattice, mapping.corners()
    kept = math.prod(lattice.shape) <= kept_sites
    whole = np.zeros(lattice.shape if kept else (0, 0), dtype=np.uint16)
    total: TileSums | None = None
    first_pass = _mapped(mapping, corners, executor, _itself if kept else _nothing)
    for done, (tile, sums) in enumerate(first_pass, start=1):
        if tile is not None:
            whole[tile.window] = tile.size_index
        total = sums if total is None else total + sums
        progress("mapping", done, len(corners))
    assert total is not None  # An aperture holds at least one site, and so one tile.
    if mapping.sample is not None:
        total = total.with_light_of(mapping.sample)

    def remapped(
        function: Callable[[PillarTile], Any], executor: Executor | None = executor, ahead: int = AHEAD
    ) -> Iterator[Any]:
        """Map all tiles again, and yield ``function`` of each."""
        return (found for found, _ in _mapped(mapping, corners, executor, function, ahead))

    if kept:
        pillars = PillarMap.from_array(lattice, table.size_dbu, whole, mapping.tile_sites)
    else:
        tiles = partial(remapped, _itself)
        pillars = PillarMap(lattice, table.size_dbu, tiles, mapping.tile_sites, remapped=remapped)
    each = None if total.each is None else total.each.figures(library, table, mapping.offset_rad)
    found = () if mapping.lights is None else _of_lights(mapping.lights, lights, total, design)
    return Assignment(pillars, total.figures(library, table, mapping.offset_rad), mapping.offset_rad, each, found)


def _of_lights(
    choice: LightChoice, lights: Sequence[LightTarget], total: TileSums, design: Design
) -> tuple[LightMapping, ...]:
    """Figures of the mapping of each light."""
    return tuple(
        LightMapping(
            spec.wavelength_nm,
            spec.weight,
            tuple(offset),
            sums.figures(light.library, table, offset),
            spec.angle_x_deg,
            spec.angle_y_deg,
        )
        for spec, light, sums, table, offset in zip(
            design.light, lights, total.lights, choice.sizes.tables, choice.offsets_rad.tolist(), strict=True
        )
    )


@dataclass(frozen=True)
class _Mapped(Generic[Result]):
    """Maps a tile, and applies a function to it in the same call."""

    mapping: TileMapping
    function: Callable[[PillarTile], Result]

    def __call__(self, corner: tuple[int, int]) -> tuple[Result, TileSums]:
        tile, sums = self.mapping(corner)
        return self.function(tile), sums


def _itself(tile: PillarTile) -> PillarTile:
    return tile


def _nothing(tile: PillarTile) -> None:
    """Result for a tile that is not kept, and so need not travel."""


def _mapped(
    mapping: TileMapping,
    corners: list[tuple[int, int]],
    executor: Executor | None,
    function: Callable[[PillarTile], Result],
    ahead: int = AHEAD,
) -> Iterator[tuple[Result, TileSums]]:
    """Function and sums of each tile in order, at most ``ahead`` in flight, by default on threads of this process."""
    # The choice for several lights is a matrix product; its threads would compete with those of the tiles.
    alone = nullcontext() if mapping.lights is None else one_blas_thread()
    with alone, ThreadPoolExecutor(default_workers()) as threads:
        yield from in_order(executor or threads, _Mapped(mapping, function), corners, ahead=ahead)


def mapping_of(
    profile: PhaseProfile,
    library: Library,
    design: Design,
    lights: Sequence[LightTarget] = (),
    executor: Executor | None = None,
) -> TileMapping:
    """Return the mapping of a design's tiles, with the constant phases that suit the library best.

    Arguments and errors are those of :func:`assign`.
    """
    _require_own(library, design, lights)
    each = allowed_sizes(library, design)
    aperture = Aperture.of(design)
    joint = joint_sizes(library, design, each, aperture.lattice)
    choice = neighbour_choice(library, design, each)
    of_lights = _light_choice(lights, each, aperture, design.rules.retardance) if lights else None
    if of_lights is None:
        keeps = _keeps_retardance(_sampled_targets(profile, aperture), each, design.rules.retardance)
        offsets = constant_phases(profile, each, aperture, keep_retardance=keeps)
    else:
        own = [light.key for light in design.light].index((design.unit_cell.illumination.wavelength_nm, 0.0, 0.0))
        offset_x, offset_y = of_lights.offsets_rad[own].tolist()
        offsets = offset_x, offset_y
    table = each if joint is None else joint.table
    outline = Outline.of(design)
    mapping = TileMapping(
        profile, table, aperture, offsets, tile_sites(design), joint, choice, lights=of_lights, outline=outline
    )
    return _by_table(mapping, executor) if design.rules.neighbours == "table" else mapping


def _require_own(library: Library, design: Design, lights: Sequence[LightTarget]) -> None:
    """Refuse (InputError) libraries of another cell than the design's, or other lights than the design's.

    Height and materials may differ: a library of other ones stands for other pillars in the same mask.
    """
    require_types("layout", library=(library, Library), design=(design, Design))
    faults = [*_differences("library", library.unit_cell, design.unit_cell)]
    if len(lights) != len(design.light):
        got, remedy = f"{len(lights)}", "give a `LightTarget` for each light"
        faults.append(Fault("lights", f"{len(design.light)}, as many as the design has", got, remedy))
    for number, (light, spec) in enumerate(zip(lights, design.light, strict=False)):
        lit = replace(design.unit_cell.illumination, wavelength_nm=spec.wavelength_nm)
        wanted = replace(design.unit_cell, illumination=lit)
        faults += _differences(f"lights[{number}].library", light.library.unit_cell, wanted)
    if faults:
        raise InputError(design.name, faults)


def _differences(name: str, cell: UnitCell, wanted: UnitCell) -> Iterator[Fault]:
    """Faults of a library called ``name`` whose cell has another lattice, shape or illumination than the wanted one."""
    for key in ("cell.period_nm", "cell.is_hexagonal", "cell.shape", "illumination"):
        got, expected = attrgetter(key)(cell), attrgetter(key)(wanted)
        if got != expected:
            remedy = "give the library of the design's unit cell"
            yield Fault(f"{name}.unit_cell.{key}", f"that of the design, {expected}", str(got), remedy)


def _by_table(mapping: TileMapping, executor: Executor | None) -> TileMapping:
    """Mapping by one look-up a pillar, from the mean change of t that the choice among neighbours makes in a sample.

    Other windows, if the lens has them, measure the light of the mapping.
    """
    sampled = replace(mapping, tile_sites=_WINDOW_SITES)
    corners = sampled.corners()
    spread = (np.arange(1, 2 * _WINDOWS + 1) * _GOLDEN % 1.0 * len(corners)).astype(np.int64)
    chosen = np.unique(spread[:_WINDOWS])
    unseen = np.setdiff1d(spread[_WINDOWS:], chosen)
    with ThreadPoolExecutor(default_workers()) as threads:
        each = partial(in_order, executor or threads, ahead=AHEAD)
        sums = sum(each(sampled.phase_shifts, [corners[k] for k in chosen]))
        places = np.meshgrid(*[np.arange(mapping.table.cells) * (SHIFT_CELLS / mapping.table.cells)] * 2, indexing="ij")
        turned = [map_coordinates(shift, places, order=1, mode="grid-wrap") for shift in np.asarray(sums)]
        table = mapping.table.shifted(np.angle(turned).astype(np.float64))
        judged = [corners[k] for k in (unseen if unseen.size else chosen)]
        first, *others = each(partial(sampled.sampled, table=table), judged)
    return replace(mapping, table=table, choice=None, sample=sum(others, first))


def _keeps_retardance(
    targets_rad: Iterable[FloatArray], table: SizeTable, rule: Literal["auto", "kept", "free"]
) -> bool:
    """Whether one constant phase serves both polarisations, so that their relative phase is that of the targets.

    ``targets_rad``, each of shape (2, n), are target phases of a sample of sites. With the rule "auto", a constant
    difference of x and y polarisation other than 0 is kept: without it, such a target has no meaning. InputError if the
    sizes respond equally to both.
    """
    if rule == "free":
        return False
    plate = wave_plate(targets_rad)
    if plate is not None and np.abs(table.t[:, 1] - table.t[:, 0]).max() <= _SAME_T:
        expected = "one phase for x and y polarisation, to which all sizes that may be used respond equally"
        got = f"a retardance of {np.angle(plate):.3g} rad"
        remedy = 'use rectangles or ellipses, not squares or circles, or give it up by `rules.retardance = "free"`'
        raise InputError.single("layout", "phase", expected, got, remedy)
    return rule == "kept" or plate is not None


def wave_plate(targets_rad: Iterable[FloatArray]) -> complex | None:
    """exp(i phase) of the wave plate that targets are, by their phase of y over x; None where that varies or is 0.

    ``targets_rad``, each of shape (2, n), are evaluated only until the phase varies.
    """
    first, turns = None, False
    for target_rad in targets_rad:
        relative = np.exp(1j * (target_rad[1] - target_rad[0]))
        first = complex(relative[0]) if first is None else first
        if np.any(np.abs(relative - first) >= _SAME_RAD):
            return None
        turns = turns or bool(np.any(np.abs(relative - 1.0) > _SAME_RAD))
    return first if turns else None


def _light_choice(
    lights: Sequence[LightTarget], table: SizeTable, aperture: Aperture, retardance: Literal["auto", "kept", "free"]
) -> LightChoice:
    """Choice among the sizes of ``table`` for several lights, with constant phases that suit a sample of the sites."""
    sizes = SizesOfLights.of(table, [light.library for light in lights], [light.weight for light in lights])
    profiles = tuple(light.profile for light in lights)
    targets = np.array([np.concatenate([*_sampled_targets(each, aperture)], axis=1) for each in profiles])
    keeps = [_keeps_retardance([target], own, retardance) for target, own in zip(targets, sizes.tables, strict=True)]
    return LightChoice(profiles, sizes, sizes.constant_phases(targets, keeps))


def _sampled_targets(profile: PhaseProfile, aperture: Aperture) -> Iterator[FloatArray]:
    """Yield target phases at up to :data:`_SAMPLED_LINES` evenly spread sites of the aperture, line by line: (2, n)."""
    lattice = aperture.lattice
    rows, columns = _sampled_lines(lattice.shape[0]), _sampled_lines(lattice.shape[1])
    inside = np.flatnonzero(aperture.at(rows, columns))
    row, column = np.divmod(inside[_sampled_lines(inside.size)], columns.size)
    x_um, y_um = lattice.x_um()[columns], lattice.y_um()[rows]
    for line in np.unique(row):
        yield profile(x_um[column[row == line]], y_um[line : line + 1])[:, 0]


def constant_phases(
    profile: PhaseProfile, table: SizeTable, aperture: Aperture, *, keep_retardance: bool = False
) -> tuple[float, float]:
    """Constant phases (x, y polarisation) that suit the library best, from a sample of at most a million sites.

    With ``keep_retardance``, both are equal.
    """
    lattice = aperture.lattice
    rows, columns = _sampled_lines(lattice.shape[0]), _sampled_lines(lattice.shape[1])
    x_um, y_um = lattice.x_um()[columns], lattice.y_um()
    histogram = np.zeros(table.size_index.shape, dtype=np.int64)
    for block in np.array_split(rows, max(1, rows.size // 64)):
        target = profile(x_um, y_um[block])
        inside = aperture.at(block, columns)
        histogram += table.histogram(target[0][inside], target[1][inside])
    return global_offsets(table, histogram, keep_retardance=keep_retardance)


def _sampled_lines(count: int) -> NDArray[np.int64]:
    """Up to :data:`_SAMPLED_LINES` of ``count`` lines, a golden-ratio sequence: even, without a period."""
    return np.unique((np.arange(1, _SAMPLED_LINES + 1) * _GOLDEN % 1.0 * count).astype(np.int64))
