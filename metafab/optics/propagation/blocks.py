"""Which blocks a stack takes: the coarsest that keep the error asked, found on the worst directions and depths."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import Executor

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.parallel.progress import Progress
from metafab.optics.geometry.imaging import Imaging
from metafab.optics.geometry.path import Ray
from metafab.optics.propagation.image import Tangent, Window
from metafab.optics.propagation.pupil import Carrier, Pupil, reduce_field, unfollowed_phase_rad
from metafab.optics.sources.source import Source

#: Blocks a side of the first pass: as many as 1e-4 takes for the lenses that were measured.
_FIRST_BLOCKS = 180
_FEWEST_BLOCKS = 8
_UNFOLLOWED_PHASE_RAD = 1e-4
#: Blocks across which the window's edges turn the phase by more are not worth a trial.
_LARGEST_EDGE_PHASE_RAD = 1.0
#: Errors above are not told from their estimates where few blocks are lit; finer ones cost next to nothing.
_COARSEST_TARGET = 1e-2
#: Of 96 bytes for a polarisation's sums, with the coarser ones; beyond it, a machine of the usual size swaps.
_MOST_BLOCKS = 20_000_000


def reduce_to_target(
    source: Source,
    windows: Sequence[Window],
    depths_m: list[float],
    tangent: Tangent,
    grid: tuple[FloatArray, FloatArray] | None,
    target_error: float,
    executor: Executor,
    progress: Progress,
    *,
    workers: int | None = None,
) -> tuple[list[list[Pupil]], Pupil]:
    """Per polarisation, the pupil of the coarsest blocks that keep the target and coarser ones; y's for x's window.

    The first of ``windows`` sets the carriers; the target (1e-2, where more is allowed) is kept in all.

    Raises:
        InputError: the blocks that it takes would not fit into memory.
    """
    imaging, target_error = windows[0].imaging, min(target_error, _COARSEST_TARGET)
    probes = [tangent]
    if grid is not None:
        probes += [(float(t_x), float(t_y)) for t_x in grid[0][[0, -1]] for t_y in grid[1][[0, -1]]]
    middle = tuple(float(np.mean([probe[axis] for probe in probes])) for axis in (0, 1))
    mean_vergence = 0.5 * (1.0 / depths_m[0] + 1.0 / depths_m[-1])
    mean_depth = 1.0 / mean_vergence if mean_vergence > 0.0 else math.inf
    rays = [Ray.towards_image(imaging, p, mean_depth, (middle[0], middle[1])) for p in (0, 1)]
    block = _first_block(source, rays, windows[0])
    stray = Carrier(1, Ray.towards_image(imaging, 0, mean_depth, tangent).in_air, _stray_block(imaging, source, block))
    stray_pupil: Pupil | None = None
    ends = sorted({depths_m[0], depths_m[-1]})

    def kept(pyramids: list[list[Pupil]], level: int) -> bool:
        """Whether blocks of this level keep the target; the polarisations are judged side by side."""
        jobs = [
            executor.submit(Window.irradiance, window, pyramids[p][level:], p, probe, ends)
            for window in windows
            for probe in probes
            for p in (0, 1)
        ]
        return max(float(job.result()[1].max()) for job in jobs) <= target_error

    while True:
        require_memory(
            source, block, "target_error", "an error and a window",
            "allow a larger error, a smaller window or field, or a smaller aperture",
        )  # fmt: skip
        carriers = [Carrier(p, ray.in_air, block) for p, ray in enumerate(rays)] + (
            [stray] if stray_pupil is None else []
        )
        first, second, *rest = reduce_field(source, carriers, imaging.wavenumber, workers=workers, progress=progress)
        stray_pupil = rest[0] if rest else stray_pupil
        assert stray_pupil is not None
        pyramids = [_pyramid(first), _pyramid(second)]
        for level in range(len(pyramids[0]) - 2, -1, -1):
            edge_phase_rad = _edge_phase_rad(windows[0], max(pyramids[0][level].block_um))
            if (level == 0 or edge_phase_rad <= _LARGEST_EDGE_PHASE_RAD) and kept(pyramids, level):
                return [pyramid[level:] for pyramid in pyramids], stray_pupil
        if block == 1:
            return pyramids, stray_pupil
        block = max(1, block // 4)


def _first_block(source: Source, rays: Sequence[Ray], window: Window) -> int:
    """Sites a side of the first pass' blocks: a multiple of 8 where it is large, as vector units like it."""
    lattice, k = source.lattice, window.imaging.wavenumber
    pitch_um = max(lattice.period_dbu) * lattice.database_unit_nm * 1e-3
    block = max(1, max(lattice.shape) // _FIRST_BLOCKS)
    while block > 1 and (
        max(unfollowed_phase_rad(source, ray, k, block) for ray in rays) > _UNFOLLOWED_PHASE_RAD
        or _edge_phase_rad(window, block * pitch_um) > _LARGEST_EDGE_PHASE_RAD
    ):
        block //= 2
    return block if block < 12 else 8 * round(block / 8)


def require_memory(source: Source, block: int, field: str, what: str, remedy: str) -> None:
    """Refuse blocks of so few sites a side that their sums would not fit into memory.

    Raises:
        InputError: names the ``field`` that asks for them, ``what`` it should be and the remedy.
    """
    n_y, n_x = source.lattice.shape
    blocks = -(-n_y // block) * -(-n_x // block)
    if blocks > _MOST_BLOCKS:
        raise InputError.single(
            "optics", field, f"{what} that {_MOST_BLOCKS:.0e} block sums carry",
            f"{blocks:.1e} blocks of {block} sites a side, {96 * blocks / 1e9:.0f} GB a polarisation", remedy,
        )  # fmt: skip


def _edge_phase_rad(window: Window, block_um: float) -> float:
    """Phase from the middle of a block to its edge that the window's edge adds to its centre's."""
    half_um = 0.5 * window.window_px * window.imaging.pixel_um
    sine = half_um / math.hypot(half_um, window.imaging.sensor_distance_um)
    return window.imaging.wavenumber * sine * 0.5 * block_um


def _pyramid(pupil: Pupil) -> list[Pupil]:
    levels = [pupil]
    while min(levels[-1].power.shape) > _FEWEST_BLOCKS or len(levels) < 2:
        levels.append(levels[-1].halved())
    return levels


def _stray_block(imaging: Imaging, source: Source, largest: int) -> int:
    """A block whose sums do not fold the other polarisation's image onto the window.

    Blocks of side h alias light that lands a multiple of lambda R / h away; the other image stands 2 sin(theta)
    away in direction, so 2 sin(theta) h / lambda must be far from a whole number.
    """
    lattice = source.lattice
    pitch_um = lattice.period_dbu[0] * lattice.database_unit_nm * 1e-3
    per_site = 2.0 * np.sin(np.radians(imaging.split_angle_deg)) * pitch_um / imaging.wavelength_um
    if per_site == 0.0:
        return largest
    good = [b for b in range(1, largest + 1) if 0.25 <= (b * per_site) % 1.0 <= 0.75]
    return good[-1] if good else 1
