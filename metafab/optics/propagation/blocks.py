"""Choice of the pupil blocks: the coarsest that keep the target error in the worst directions and at the end depths."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np

from metafab.core.errors import InputError
from metafab.core.parallel.executor import in_order
from metafab.core.parallel.work import Work
from metafab.optics.geometry.imaging import FieldGrid, Imaging, Tangent
from metafab.optics.geometry.path import Ray
from metafab.optics.propagation.image import Window
from metafab.optics.propagation.pupil import Carrier, Pupil, expansion_error_rad, reduce_field
from metafab.optics.sources.oblique import COEFFICIENTS, oblique_of
from metafab.optics.sources.source import Source

#: Blocks along a side in the first pass: enough for an error of 1e-4 with the lenses that were measured.
_FIRST_BLOCKS = 180
#: Blocks along a side, up to which a pyramid is coarsened.
_FEWEST_BLOCKS = 8
#: Largest phase error of the path expansion inside a block.
_EXPANSION_ERROR_RAD = 1e-4
#: Largest phase from a block's middle to its edge, for light to the window's edge; larger blocks are not tried.
_LARGEST_EDGE_PHASE_RAD = 1.0
#: Largest target error that is used: estimates of larger ones are unreliable where few blocks are lit, and this one
#: costs next to nothing.
COARSEST_TARGET = 1e-2
#: Errors that are estimated side by side; those after the first that is too large are discarded.
_AHEAD = 4
#: Limit of scratch in memory or on disk: a polarisation takes 75 bytes per block, coarser blocks included.
MOST_BLOCKS = 20_000_000


def reduce_to_target(
    source: Source,
    windows: Sequence[Window],
    depths_m: Sequence[float],
    tangent: Tangent,
    grid: FieldGrid | None,
    target_error: float,
    executor: Executor,
    work: Work = Work(),
    *,
    most_blocks: int = MOST_BLOCKS,
) -> tuple[list[list[Pupil]], Pupil]:
    """Return the pupils of the coarsest blocks that keep the target error in all ``windows``.

    Args:
        source: field behind the metasurface; one that depends on the direction is that from ``tangent``.
        windows: windows in which the error is estimated; the first sets the carriers.
        depths_m: shape (n_depth,), object depths, ascending.
        tangent: object direction.
        grid: directions over the field of view; its corners are tried, too.
        target_error: largest relative L2 error; 1e-2 is used if it is larger.
        executor: estimates errors side by side.
        work: threads and progress of the passes over the source.
        most_blocks: memory limit.

    Returns:
        For each polarisation, the pupil followed by ever coarser ones; and the pupil of y polarised light for the
        window of x.

    Raises:
        InputError: the blocks do not fit into memory.
    """
    imaging, target_error = windows[0].imaging, min(target_error, COARSEST_TARGET)
    probes = [tangent]
    if grid is not None:
        probes += [(float(t_x), float(t_y)) for t_x in grid[0][[0, -1]] for t_y in grid[1][[0, -1]]]
    middle = (float(np.mean([probe[0] for probe in probes])), float(np.mean([probe[1] for probe in probes])))
    mean_vergence = 0.5 * (1.0 / depths_m[0] + 1.0 / depths_m[-1])
    mean_depth = 1.0 / mean_vergence if mean_vergence > 0.0 else math.inf
    rays = [Ray.towards_image(imaging, p, mean_depth, middle) for p in (0, 1)]
    block = _first_block(source, rays, windows[0])
    stray = Carrier(1, Ray.towards_image(imaging, 0, mean_depth, tangent).in_air, _stray_block(imaging, source, block))
    stray_pupil: Pupil | None = None
    ends = sorted({depths_m[0], depths_m[-1]})
    oblique = oblique_of(source)

    def keep_target(pyramids: list[list[Pupil]], level: int) -> bool:
        """Whether blocks of this level keep the target in all windows and directions; the first that fails decides."""
        error = partial(_largest_error, [pyramid[level:] for pyramid in pyramids], ends)
        cases = product(windows, probes[::-1], (0, 1))  # corners of the field first, where blocks fail first
        with closing(in_order(executor, error, cases, ahead=_AHEAD)) as errors:
            return all(each <= target_error for each in errors)

    while True:
        require_memory(
            source,
            block,
            "target_error",
            "an error and a window",
            "allow a larger error, a smaller window or field, or a smaller aperture",
            most_blocks,
        )
        carriers = [Carrier(p, ray.in_air, block) for p, ray in enumerate(rays)]
        carriers += [stray] if stray_pupil is None else []
        count = len(carriers)
        if oblique is not None and grid is not None:
            further = range(2, 2 + 2 * COEFFICIENTS)  # the coefficients of x, then those of y polarisation
            carriers += [replace(carriers[(k - 2) // COEFFICIENTS], polarisation=k) for k in further]
        pupils = reduce_field(source, carriers, imaging.wavenumber, work)
        pupils, changes = pupils[:count], pupils[count:]
        stray_pupil = pupils.pop() if stray_pupil is None else stray_pupil
        pairs = zip(pupils, (changes[:COEFFICIENTS], changes[COEFFICIENTS:]), strict=True)
        pyramids = [_pyramid(replace(pupil, tangent=tangent, changes=tuple(its))) for pupil, its in pairs]
        del pupils, changes  # the finest of a pyramid is freed with the pyramid
        for level in range(len(pyramids[0]) - 2, -1, -1):
            edge_phase_rad = _edge_phase_rad(windows[0], max(pyramids[0][level].block_um))
            if (level == 0 or edge_phase_rad <= _LARGEST_EDGE_PHASE_RAD) and keep_target(pyramids, level):
                return [pyramid[level:] for pyramid in pyramids], stray_pupil
        if block == 1:
            return pyramids, stray_pupil
        pyramids.clear()  # before finer blocks are made
        block = max(1, block // 4)


def _largest_error(pyramids: list[list[Pupil]], depths_m: list[float], case: tuple[Window, Tangent, int]) -> float:
    """Largest error over depth in a window (window, direction, polarisation)."""
    window, tangent, polarisation = case
    return float(window.irradiance(pyramids[polarisation], polarisation, tangent, depths_m)[1].max())


def require_memory(
    source: Source, block: int, field: str, expected: str, remedy: str, most_blocks: int = MOST_BLOCKS
) -> None:
    """Refuse blocks of ``block`` sites a side if there are more than ``most_blocks``: InputError.

    ``field`` is the input that requires this size, ``expected`` the start of the phrase for its valid values.
    """
    n_y, n_x = source.lattice.shape
    blocks = -(-n_y // block) * -(-n_x // block)
    if blocks > most_blocks:
        got = f"{blocks:.1e} blocks of {block} sites a side, {75 * blocks / 1e9:.0f} GB per polarisation"
        expected = f"{expected} for which {most_blocks:.0e} block sums suffice"
        raise InputError.single("optics", field, expected, got, remedy)


def _first_block(source: Source, rays: Sequence[Ray], window: Window) -> int:
    """Sites along a side of the blocks of the first pass; large blocks are multiples of 8, for vector instructions."""
    lattice, k = source.lattice, window.imaging.wavenumber
    pitch_um = max(lattice.period_dbu) * lattice.database_unit_nm * 1e-3
    block = max(1, max(lattice.shape) // _FIRST_BLOCKS)
    while block > 1 and (
        max(expansion_error_rad(source, ray, k, block) for ray in rays) > _EXPANSION_ERROR_RAD
        or _edge_phase_rad(window, block * pitch_um) > _LARGEST_EDGE_PHASE_RAD
    ):
        block //= 2
    return block if block < 12 else 8 * round(block / 8)


def _edge_phase_rad(window: Window, block_um: float) -> float:
    """Phase from the middle of a block to its edge, at the window's edge relative to the window's centre."""
    half_um = 0.5 * window.window_px * window.imaging.pixel_um
    sine = half_um / math.hypot(half_um, window.imaging.sensor_distance_um)
    return window.imaging.wavenumber * sine * 0.5 * block_um


def _pyramid(pupil: Pupil) -> list[Pupil]:
    levels = [pupil]
    while min(levels[-1].power.shape) > _FEWEST_BLOCKS or len(levels) < 2:
        levels.append(levels[-1].coarsened())
    return levels


def _stray_block(imaging: Imaging, source: Source, largest: int) -> int:
    """Block size whose sums do not alias the image of the other polarisation into the window.

    Blocks of side h alias light across directions that differ by a multiple of lambda / h. The other image differs by
    2 sin(theta), so that 2 sin(theta) h / lambda must be far from a whole number.
    """
    lattice = source.lattice
    pitch_um = lattice.period_dbu[0] * lattice.database_unit_nm * 1e-3
    per_site = 2.0 * np.sin(np.radians(imaging.split_angle_deg)) * pitch_um / imaging.wavelength_um
    if per_site == 0.0:
        return largest
    good = [b for b in range(1, largest + 1) if 0.25 <= (b * per_site) % 1.0 <= 0.75]
    return good[-1] if good else 1
