"""The PSF pair over depth and field: chooses the blocks, runs window after window, and adds up the power."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import AbstractContextManager

import numpy as np
from threadpoolctl import threadpool_limits

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.parallel.executor import default_workers, open_executor
from metafab.core.parallel.progress import Progress, silent
from metafab.optics.geometry.imaging import Imaging
from metafab.optics.geometry.path import Ray, power_at_aperture
from metafab.optics.measures.lobe import orientation_deg
from metafab.optics.point_spread import Psf, PsfField
from metafab.optics.propagation.blocks import reduce_to_target
from metafab.optics.propagation.image import Tangent, Window
from metafab.optics.propagation.pupil import Pupil
from metafab.optics.sources.source import Source
from metafab.optics.validation import require_answerable


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
    workers: int | None = None,
    cluster: str | None = None,
    progress: Progress = silent,
) -> Psf:
    """Point-spread functions of both polarisations behind a metasurface.

    Args:
        source: what leaves the metasurface (:func:`written_field`, :func:`ideal_field`).
        imaging: wavelength, sensor plane, sampling, aperture.
        depths_m: object depths, ascending; ``math.inf`` is allowed.
        tangent: object direction (x/z, y/z) of the pair itself.
        window_px: points a side of each window.
        target_error: wanted relative L2 error of the irradiance, 4e-6 (1e-5 with a filter) to 1.
        field_points: points a side of the grid over the field of view; 1 for none.
        field_tangents: the grid's (x/z, y/z), shapes (n_x,) and (n_y,); without them ``field_points`` points
            span the field whose twin images just touch, -tan(theta) to tan(theta).
        filter_fwhm_nm: full width of a filter with a flat top about the wavelength; None for one wavelength.
        workers: threads; None for all cores. The result is the same, bit for bit.
        cluster: address of a Dask scheduler that runs polarisations and directions instead.
        progress: called as tiles and windows are done.

    Returns:
        The pair; ``error`` bounds what block sums, low rank and single precision cost, ``details`` says where
        the light went that is not in the windows.

    Raises:
        InputError: depths that are not positive and ascending, an object whose light does not reach the sensor,
            numbers out of range, or pixels too coarse to add up to the power in the window or to add a filter's
            wavelengths.
    """
    begun = time.perf_counter()
    depths = [float(z) for z in depths_m]
    grid = _field_grid(imaging, field_points, field_tangents)
    require_answerable(imaging, depths, tangent, grid, window_px, target_error, filter_fwhm_nm)
    window = Window.for_target(imaging, window_px, target_error)
    windows = window.over_band(tangent, filter_fwhm_nm)
    # Blocks and wavelengths share the target.
    target_error *= 1.0 if filter_fwhm_nm is None else 0.5
    tasks = [(p, tangent) for p in (0, 1)]
    if grid is not None:
        tasks += [(p, (float(t_x), float(t_y))) for p in (0, 1) for t_y in grid[1] for t_x in grid[0]]
    images: list[FloatArray] = []
    errors: list[FloatArray] = []
    with threadpool_limits(1, "blas"), _executor(workers, cluster) as pool:
        pyramids, stray = reduce_to_target(
            source, windows, depths, tangent, grid, target_error, pool, progress, workers=workers
        )
        unwanted_light = pool.submit(Window.stray_irradiance, window, stray, 0, tangent, depths)
        jobs = [
            pool.submit(
                Window.light,
                window,
                pyramids[p],
                p,
                t,
                depths,
                filter_fwhm_nm,
                target_error,
                judged="all" if index < 2 else "ends",
            )
            for index, (p, t) in enumerate(tasks)
        ]
        for done, job in enumerate(jobs):
            image, error = job.result()
            images.append(image if done < 2 else image.astype(np.float32))
            errors.append(error)
            progress("psf", done + 1, len(tasks))
        unwanted = unwanted_light.result().sum(axis=(1, 2)) * imaging.pixel_um**2

    pair = np.array(images[:2])
    efficiency = pair.sum(axis=(2, 3)) * imaging.pixel_um**2
    with np.errstate(divide="ignore", invalid="ignore"):
        extinction = efficiency[0] / unwanted
    centres = np.array([np.tile(imaging.image_point_um(p, tangent), (len(depths), 1)) for p in (0, 1)])
    details: dict[str, float | str] = {
        "block_sites": float(pyramids[0][0].carrier.block_sites),
        "blocks": float(pyramids[0][0].power.size),
        "field_error": float(max(error.max() for error in errors[2:])) if grid is not None else float("nan"),
        **({} if filter_fwhm_nm is None else {"filter_fwhm_nm": filter_fwhm_nm}),
        **_power_budget(imaging, [pyramid[0] for pyramid in pyramids], tangent, depths, efficiency),
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


def _executor(workers: int | None, cluster: str | None) -> AbstractContextManager[Executor]:
    """Threads, as kernels and matrix products leave them free to run; or a cluster."""
    if cluster is not None:
        return open_executor(cluster=cluster)
    return ThreadPoolExecutor(default_workers() if workers is None else workers)


def _field_grid(
    imaging: Imaging, field_points: int, field_tangents: tuple[FloatArray, FloatArray] | None
) -> tuple[FloatArray, FloatArray] | None:
    if field_tangents is None and field_points < 1:
        raise InputError.single("optics", "field_points", "at least 1 point a side", str(field_points))
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


def _power_budget(
    imaging: Imaging, pupils: Sequence[Pupil], tangent: Tangent, depths_m: list[float], efficiency: FloatArray
) -> dict[str, float | str]:
    """Where the power at the aperture goes, for the middle depth: window, stray, and not transmitted."""
    middle = len(depths_m) // 2
    budget: dict[str, float | str] = {}
    for index, name in enumerate("xy"):
        ray = Ray.towards_image(imaging, index, depths_m[middle], tangent)
        transmitted = pupils[index].transmitted(ray) / power_at_aperture(imaging, ray)
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
