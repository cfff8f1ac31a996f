"""The PSF pair over depth and field: chooses the blocks, runs window after window, and adds up the power."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from threadpoolctl import threadpool_limits

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.executor import default_workers
from metafab.core.progress import Progress, silent
from metafab.optics.band import band_ends, band_irradiance
from metafab.optics.imaging import Imaging
from metafab.optics.lobe import orientation_deg
from metafab.optics.path import Ray, power_at_aperture
from metafab.optics.point_spread import Psf, PsfField
from metafab.optics.pupil import Carrier, Pupil, mixed_phase_rad, reduce_field
from metafab.optics.source import Source
from metafab.optics.window import WindowKernel, WindowTransform, refocus

Tangent = tuple[float, float]

#: Blocks a side of the first pass: as many as 1e-3 takes for the lenses that were measured, and twice as many.
_FIRST_BLOCKS = 240
_LEVELS = 5
_MIXED_PHASE_RAD = 1e-4
_SINGLE_PRECISION_ERROR = 2e-6


@dataclass(frozen=True)
class _Window:
    """What all windows share."""

    imaging: Imaging
    window_px: int
    tolerance: float

    def kernel(self, pupils: Sequence[Pupil], target_um: tuple[float, float, float]) -> WindowKernel:
        x, y = (
            (min(float(axis[0]) for axis in axes), max(float(axis[-1]) for axis in axes))
            for axes in ([p.x_um for p in pupils], [p.y_um for p in pupils])
        )
        imaging = self.imaging
        return WindowKernel.build(
            imaging.wavenumber, target_um, (x, y), self.window_px, imaging.pixel_um, self.tolerance
        )

    def irradiance(
        self,
        pupils: Sequence[Pupil],
        polarisation: int,
        tangent: Tangent,
        depths_m: Sequence[float],
        *,
        judge_all: bool = True,
    ) -> tuple[FloatArray, FloatArray]:
        """PSFs about the geometric image point, shape (n_depth, n, n), and the error of each that is judged.

        Blocks are followed to second order in their size, so that twice the size has four times the error or
        more: a third of the change from twice the size is a bound. Blocks of one site are exact. The error
        changes slowly with depth; over the field only the first and the last depth are judged.
        """
        rays = [Ray.towards_image(self.imaging, polarisation, depth, tangent) for depth in depths_m]
        k = self.imaging.wavenumber
        used = pupils[:1] if pupils[0].carrier.block_sites == 1 else pupils[:2]
        kernel = self.kernel(used, rays[0].target_um)
        transforms = [WindowTransform.build(pupil, kernel) for pupil in used]
        images, errors = [], []
        for index, ray in enumerate(rays):
            fine = np.abs(transforms[0].field(refocus(used[0], ray, k)).astype(np.complex128)) ** 2
            images.append(fine * self._per_unit_power(pupils[0], ray))
            if judge_all or index in {0, len(rays) - 1}:
                coarse = np.abs(transforms[1].field(refocus(used[1], ray, k))) ** 2 if len(used) > 1 else fine
                errors.append(relative_l2(coarse, fine) / 3.0 + 2.0 * self.tolerance + _SINGLE_PRECISION_ERROR)
        return np.array(images), np.array(errors)

    def band_irradiance(
        self,
        pupils: Sequence[Pupil],
        polarisation: int,
        tangent: Tangent,
        depths_m: Sequence[float],
        filter_fwhm_nm: float,
        target_error: float,
        *,
        judge_all: bool = True,
    ) -> tuple[FloatArray, FloatArray]:
        """As :meth:`irradiance`, in the light of a filter."""

        def monochromatic(imaging: Imaging, side_px: int) -> tuple[FloatArray, FloatArray]:
            there = replace(self, imaging=imaging, window_px=side_px)
            return there.irradiance(pupils, polarisation, tangent, depths_m, judge_all=judge_all)

        return band_irradiance(
            monochromatic, self.imaging, polarisation, tangent, filter_fwhm_nm, self.window_px, target_error
        )

    def stray_irradiance(
        self, pupil: Pupil, polarisation: int, tangent: Tangent, depths_m: Sequence[float]
    ) -> FloatArray:
        """Irradiance of ``pupil``'s light in the window of ``polarisation``, shape (n_depth, n, n)."""
        rays = [Ray.towards_image(self.imaging, polarisation, depth, tangent) for depth in depths_m]
        k = self.imaging.wavenumber
        transform = WindowTransform.build(pupil, self.kernel([pupil], rays[0].target_um))
        images = [
            np.abs(transform.field(refocus(pupil, ray, k))) ** 2 * self._per_unit_power(pupil, ray) for ray in rays
        ]
        return np.array(images)

    def _per_unit_power(self, pupil: Pupil, ray: Ray) -> float:
        cell_um2 = pupil.pitch_um[0] * pupil.pitch_um[1]
        return cell_um2 * cell_um2 / power_at_aperture(self.imaging, ray)


def psf(
    source: Source,
    imaging: Imaging,
    depths_m: Sequence[float] | FloatArray,
    *,
    tangent: Tangent = (0.0, 0.0),
    window_px: int = 64,
    target_error: float = 1e-3,
    field_points: int = 1,
    field_tangents: tuple[FloatArray, FloatArray] | None = None,
    filter_fwhm_nm: float | None = None,
    progress: Progress = silent,
) -> Psf:
    """Point-spread functions of both polarisations behind a metasurface.

    Args:
        source: what leaves the metasurface (:func:`written_field`, :func:`ideal_field`).
        imaging: wavelength, sensor plane, sampling, aperture.
        depths_m: object depths, ascending; ``math.inf`` is allowed.
        tangent: object direction (x/z, y/z) of the pair itself.
        window_px: points a side of each window.
        target_error: wanted relative L2 error of the irradiance.
        field_points: points a side of the grid over the field of view; 1 for none.
        field_tangents: the grid's (x/z, y/z), shapes (n_x,) and (n_y,); without them ``field_points`` points
            span the field whose twin images just touch, -tan(theta) to tan(theta).
        filter_fwhm_nm: full width of a filter with a flat top about the wavelength; None for one wavelength.
        progress: called as tiles and windows are done.

    Returns:
        The pair; ``error`` bounds what block sums, low rank and single precision cost, ``details`` says where
        the light went that is not in the windows.

    Raises:
        InputError: depths that are not positive and ascending, an object whose light does not reach the sensor, or
            pixels too coarse to add a filter's wavelengths.
    """
    begun = time.perf_counter()
    depths = _checked_depths(depths_m)
    grid = _field_grid(imaging, field_points, field_tangents)
    window = _Window(imaging, window_px, min(0.1 * target_error, 1e-3))
    windows = [window]
    if filter_fwhm_nm is not None:
        # Blocks and wavelengths share the target.
        target_error *= 0.5
        windows += [replace(window, imaging=end) for end in band_ends(imaging, filter_fwhm_nm)]
    pupils, stray_pupil = _reduce(source, windows, depths, tangent, grid, target_error, progress)

    tasks = [(p, tangent) for p in (0, 1)]
    if grid is not None:
        tasks += [(p, (float(t_x), float(t_y))) for p in (0, 1) for t_y in grid[1] for t_x in grid[0]]
    images: list[FloatArray] = []
    errors: list[FloatArray] = []

    def light(p: int, t: Tangent, judge_all: bool) -> tuple[FloatArray, FloatArray]:
        if filter_fwhm_nm is None:
            return window.irradiance(pupils[p], p, t, depths, judge_all=judge_all)
        return window.band_irradiance(pupils[p], p, t, depths, filter_fwhm_nm, target_error, judge_all=judge_all)

    with threadpool_limits(1, "blas"), ThreadPoolExecutor(default_workers()) as threads:
        jobs = [threads.submit(light, p, t, index < 2) for index, (p, t) in enumerate(tasks)]
        for done, job in enumerate(jobs):
            image, error = job.result()
            images.append(image if done < 2 else image.astype(np.float32))
            errors.append(error)
            progress("psf", done + 1, len(tasks))

    pair = np.array(images[:2])
    efficiency = pair.sum(axis=(2, 3)) * imaging.pixel_um**2
    unwanted = window.stray_irradiance(stray_pupil, 0, tangent, depths).sum(axis=(1, 2)) * imaging.pixel_um**2
    with np.errstate(divide="ignore", invalid="ignore"):
        extinction = efficiency[0] / unwanted
    centres = np.array([np.tile(imaging.image_point_um(p, tangent), (len(depths), 1)) for p in (0, 1)])
    details: dict[str, float | str] = {
        "block_sites": float(pupils[0][0].carrier.block_sites),
        "blocks": float(pupils[0][0].power.size),
        "field_error": float(max(error.max() for error in errors[2:])) if grid is not None else float("nan"),
        **({} if filter_fwhm_nm is None else {"filter_fwhm_nm": filter_fwhm_nm}),
        **_power_budget(imaging, pupils, tangent, depths, efficiency),
        "seconds": time.perf_counter() - begun,
    }
    return Psf(
        depth_m=np.array(depths),
        pixel_um=imaging.pixel_um,
        psf=pair,
        centre_um=centres,
        phi_deg=orientation_deg(pair[0]),
        error=np.max(errors[:2], axis=0),
        efficiency=efficiency,
        extinction_ratio=extinction,
        sensor_distance_um=imaging.sensor_distance_um,
        field=None if grid is None else _field(imaging, grid, images[2:], len(depths), window_px),
        details=details,
    )


def relative_l2(value: FloatArray, reference: FloatArray) -> float:
    """|value - reference| / |reference|; 0 where both are dark."""
    norm = float(np.linalg.norm(reference))
    difference = float(np.linalg.norm(np.asarray(value) - reference))
    return difference / norm if norm > 0.0 else (0.0 if difference == 0.0 else float("inf"))


def _checked_depths(depths_m: Sequence[float] | FloatArray) -> list[float]:
    depths = [float(z) for z in depths_m]
    if not depths or depths[0] <= 0.0 or any(not b > a for a, b in pairwise(depths)):
        raise InputError.single(
            "optics", "depths_m", "at least one positive depth, in ascending order", str(depths), "sort them"
        )
    return depths


def _field_grid(
    imaging: Imaging, field_points: int, field_tangents: tuple[FloatArray, FloatArray] | None
) -> tuple[FloatArray, FloatArray] | None:
    if field_tangents is None and field_points == 1:
        return None
    if field_tangents is None:
        reach = float(np.tan(np.radians(imaging.split_angle_deg)))
        if reach == 0.0:
            raise InputError.single(
                "optics", "field_tangents", "the field's directions for a lens without a split", "None"
            )
        axis = np.linspace(-reach, reach, field_points)
        return axis, axis.copy()
    t_x, t_y = (np.atleast_1d(np.asarray(axis, dtype=np.float64)) for axis in field_tangents)
    return None if t_x.size == t_y.size == 1 else (t_x, t_y)


def _reduce(
    source: Source,
    windows: Sequence[_Window],
    depths_m: list[float],
    tangent: Tangent,
    grid: tuple[FloatArray, FloatArray] | None,
    target_error: float,
    progress: Progress,
) -> tuple[list[list[Pupil]], Pupil]:
    """Per polarisation, the pupils of the coarsest two block sizes that keep the target; and y's for x's window.

    The first of ``windows`` sets the carriers; the target is kept in all.
    """
    imaging = windows[0].imaging
    probes = [tangent]
    if grid is not None:
        probes += [(float(t_x), float(t_y)) for t_x in grid[0][[0, -1]] for t_y in grid[1][[0, -1]]]
    middle = tuple(float(np.mean([probe[axis] for probe in probes])) for axis in (0, 1))
    mean_vergence = 0.5 * (1.0 / depths_m[0] + 1.0 / depths_m[-1])
    mean_depth = 1.0 / mean_vergence if mean_vergence > 0.0 else math.inf
    rays = [Ray.towards_image(imaging, p, mean_depth, (middle[0], middle[1])) for p in (0, 1)]
    own_ray = Ray.towards_image(imaging, 0, mean_depth, tangent)
    block = max(1, max(source.lattice.shape) // _FIRST_BLOCKS)
    while block > 1 and max(mixed_phase_rad(source, ray, imaging.wavenumber, block) for ray in rays) > _MIXED_PHASE_RAD:
        block //= 2
    stray = Carrier(1, own_ray, _stray_block(imaging, source, block))
    stray_pupil: Pupil | None = None
    while True:
        carriers = [Carrier(p, ray, block) for p, ray in enumerate(rays)] + ([stray] if stray_pupil is None else [])
        first, second, *rest = reduce_field(source, carriers, imaging.wavenumber, progress=progress)
        stray_pupil = rest[0] if rest else stray_pupil
        assert stray_pupil is not None
        levels = [_pyramid(first), _pyramid(second)]
        for coarsest in range(len(levels[0]) - 2, -1, -1):
            chosen = [level[coarsest : coarsest + 2] for level in levels]
            ends = sorted({depths_m[0], depths_m[-1]})
            if all(
                window.irradiance(chosen[p], p, probe, ends)[1].max() <= target_error
                for window in windows
                for p in (0, 1)
                for probe in probes
            ):
                return chosen, stray_pupil
        if block == 1:
            return [level[:2] for level in levels], stray_pupil
        block = max(1, block // 4)


def _pyramid(pupil: Pupil) -> list[Pupil]:
    levels = [pupil]
    while len(levels) < _LEVELS:
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


def _power_budget(
    imaging: Imaging, pupils: list[list[Pupil]], tangent: Tangent, depths_m: list[float], efficiency: FloatArray
) -> dict[str, float | str]:
    """Where the power at the aperture goes, for the middle depth: window, stray, and not transmitted."""
    middle = len(depths_m) // 2
    budget: dict[str, float | str] = {}
    for index, name in enumerate("xy"):
        ray = Ray.towards_image(imaging, index, depths_m[middle], tangent)
        transmitted = pupils[index][0].transmitted(ray) / power_at_aperture(imaging, ray)
        budget[f"transmitted_{name}"] = transmitted
        budget[f"stray_{name}"] = transmitted - float(efficiency[index, middle])
        budget[f"lost_{name}"] = 1.0 - transmitted
    return budget


def _field(
    imaging: Imaging, grid: tuple[FloatArray, FloatArray], images: list[FloatArray], n_depth: int, n: int
) -> PsfField:
    t_x, t_y = grid
    stack = np.array(images, dtype=np.float32).reshape(2, t_y.size, t_x.size, n_depth, n, n)
    centres = np.array([[[imaging.image_point_um(p, (x, y)) for x in t_x] for y in t_y] for p in (0, 1)])
    centres = np.repeat(centres[:, None], n_depth, axis=1)
    return PsfField(t_x, t_y, np.ascontiguousarray(np.moveaxis(stack, 3, 1)), centres)
