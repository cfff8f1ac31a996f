"""Compute the PSF pair over depth and field: choose the pupil blocks, propagate to each window, add up the power."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.parallel.executor import one_blas_thread
from metafab.core.parallel.work import Work
from metafab.optics.geometry.imaging import FieldGrid, Imaging, Tangent
from metafab.optics.geometry.path import Ray, power_at_aperture
from metafab.optics.interpolation import at_tangent
from metafab.optics.measures.metrics import orientation_deg
from metafab.optics.numerics import PsfNumerics, require_valid
from metafab.optics.point_spread import Psf, PsfDetails, PsfField
from metafab.optics.propagation.blocks import reduce_to_target
from metafab.optics.propagation.image import Window, relative_l2
from metafab.optics.propagation.pupil import Pupil
from metafab.optics.sources.oblique import from_direction, neighbour_map_of
from metafab.optics.sources.source import Source


def psf(
    source: Source,
    imaging: Imaging,
    depths_m: Sequence[float] | FloatArray,
    numerics: PsfNumerics = PsfNumerics(),
    *,
    tangent: Tangent = (0.0, 0.0),
    field_tangents: FieldGrid | None = None,
    work: Work = Work(),
) -> Psf:
    """Return the point-spread functions of both polarisations behind a metasurface.

    Args:
        source: field behind the metasurface (:func:`metafab.optics.written_field`, :func:`metafab.optics.ideal_field`).
        imaging: wavelength, sensor plane, sampling, aperture.
        depths_m: shape (n_depth,), object depths, ascending; ``math.inf`` is allowed.
        numerics: window, target error and spectral band.
        tangent: object direction (x/z, y/z) of the pair itself.
        field_tangents: grid over the field of view, (x/z, y/z) of shapes (n_x,) and (n_y,); None for one direction.
        work: threads or cluster, and progress. The result is bit-identical for any number of threads.

    Returns:
        The pair. ``error`` bounds the errors of block sums, low-rank kernel and single precision; ``details`` accounts
        for the light outside the windows and for interpolation over the field; ``ghost`` is the light that a
        birefringent substrate brings into the wrong image.

    Raises:
        InputError: depths that are not positive and ascending, an object whose light does not reach the sensor,
            numbers out of range, or pixels too coarse to add up to the power in the window or to add the wavelengths
            of a filter.
    """
    begun = time.perf_counter()
    depths = [float(z) for z in depths_m]
    grid = None if field_tangents is None else _grid(field_tangents)
    require_valid(imaging, depths, tangent, grid, numerics)
    source = from_direction(source, tangent, grid)
    window = Window.for_target(imaging, numerics)
    windows = window.over_band(tangent, numerics.filter_fwhm_nm)
    directions = [tangent]
    if grid is not None:
        directions += [(float(t_x), float(t_y)) for t_y in grid[1] for t_x in grid[0]]
    # Polarisation of the window (and pillars), and of the object.
    entries = [(0, 0), (1, 1)] if imaging.crystal is None else [(0, 0), (1, 1), (0, 1), (1, 0)]
    tasks = [(entry, t) for t in directions[:1] for entry in entries]
    tasks += [(entry, t) for entry in entries for t in directions[1:]]
    middle, probe = len(depths) // 2, None if grid is None else _between_nodes(grid)
    images: list[FloatArray] = []
    errors: list[FloatArray] = []
    with one_blas_thread(), work.threads() as pool:
        pyramids, stray = reduce_to_target(source, windows, depths, tangent, grid, numerics.block_error, pool, work)
        unwanted_light = pool.submit(Window.stray_irradiance, window, stray, 0, tangent, depths)
        jobs = [
            pool.submit(
                Window.light,
                window,
                pyramids[entry[0]],
                entry[0],
                t,
                depths,
                numerics,
                judged="all" if index < len(entries) else "ends",
                entry=entry,
            )
            for index, (entry, t) in enumerate(tasks)
        ]
        central = depths[middle : middle + 1]
        checks = (
            []
            if probe is None
            else [
                pool.submit(Window.light, window, pyramids[p], p, probe, central, numerics, judged="none")
                for p in (0, 1)
            ]
        )
        for done, job in enumerate(jobs):
            image, error = job.result()
            images.append(image if done < len(entries) else image.astype(np.float32))
            errors.append(error)
            work.progress("psf", done + 1, len(tasks))
        between = [job.result()[0] for job in checks]
        unwanted = unwanted_light.result().sum(axis=(1, 2)) * imaging.pixel_um**2

    transmitted = [_transmitted(imaging, pyramids, p, depths[middle], tangent) for p in (0, 1)]
    over_field = np.array(images[len(entries) :], dtype=np.float32)
    parts = over_field.reshape(len(entries) // 2, -1, *over_field.shape[1:])
    pairs = [
        _pair(imaging, depths, tangent, images[i : i + 2], errors[i : i + 2], None if grid is None else (grid, part))
        for i, part in zip(range(0, len(entries), 2), parts, strict=True)
    ]
    wanted, ghost = pairs[0], pairs[1] if len(pairs) > 1 else None
    if ghost is not None:
        unwanted = unwanted + ghost.efficiency[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        extinction = wanted.efficiency[0] / unwanted
    if np.abs(np.diff(wanted.centre_um[:, 0], axis=0)).max() < imaging.pixel_um:
        extinction = np.full(len(depths), np.nan)  # one window holds the light of both polarisations
    between_error = float("nan")
    if probe is not None:
        between_error = relative_l2(at_tangent(wanted, probe)[:, middle : middle + 1], np.array(between))
    return replace(
        wanted,
        extinction_ratio=extinction,
        ghost=ghost,
        details=PsfDetails(
            block_sites=pyramids[0][0].carrier.block_sites,
            blocks=pyramids[0][0].power.size,
            transmitted=tuple(transmitted),
            stray=tuple(share - float(wanted.efficiency[p, middle]) for p, share in enumerate(transmitted)),
            field_error=float("nan") if grid is None else float(max(e.max() for e in errors[len(entries) :])),
            field_interpolation_error=between_error,
            filter_fwhm_nm=numerics.filter_fwhm_nm,
            seconds=time.perf_counter() - begun,
        ),
        aperture_um=pyramids[0][0].sub_apertures_um,
        neighbours=neighbour_map_of(source),
    )


def _pair(
    imaging: Imaging,
    depths_m: list[float],
    tangent: Tangent,
    images: list[FloatArray],
    errors: list[FloatArray],
    field: tuple[FieldGrid, NDArray[np.float32]] | None,
) -> Psf:
    """A pair on the axis and over the field, without extinction and details."""
    pair = np.array(images)
    return Psf(
        depth_m=np.array(depths_m),
        pixel_um=imaging.pixel_um,
        psf=pair,
        centre_um=np.array([np.tile(imaging.image_point_um(p, tangent), (len(depths_m), 1)) for p in (0, 1)]),
        phi_deg=orientation_deg(pair[0]),
        error=np.max(errors, axis=0),
        efficiency=pair.sum(axis=(2, 3)) * imaging.pixel_um**2,
        extinction_ratio=np.full(len(depths_m), np.nan),
        sensor_distance_um=imaging.sensor_distance_um,
        field=None if field is None else _field(imaging, *field),
    )


def _grid(field_tangents: FieldGrid) -> FieldGrid | None:
    """The grid as arrays; None for a single direction."""
    t_x, t_y = (np.atleast_1d(np.asarray(axis, dtype=np.float64)) for axis in field_tangents)
    return None if t_x.size == t_y.size == 1 else (t_x, t_y)


def _between_nodes(grid: FieldGrid) -> Tangent | None:
    """Middle of an outermost cell of the field grid, where interpolation errs most; None where cells have no area."""
    (t_x, t_y), (step_x, step_y) = grid, (np.diff(axis) for axis in grid)
    flat = min(t_x.size, t_y.size) == 1 or min(step_x.min(), step_y.min()) <= 0.0
    return None if flat else (float(t_x[-2:].mean()), float(t_y[-2:].mean()))


def _transmitted(
    imaging: Imaging, pyramids: list[list[Pupil]], incident: int, depth_m: float, tangent: Tangent
) -> float:
    """Share of one polarisation's power at the aperture that leaves the pillars, in either polarisation."""
    behind = (incident,) if imaging.crystal is None else (0, 1)
    rays = [Ray.towards_image(imaging, p, depth_m, tangent, (p, incident)) for p in behind]
    passed = sum(pyramids[p][0].transmitted(ray) for p, ray in zip(behind, rays, strict=True))
    return float(passed / power_at_aperture(imaging, rays[0]))


def _field(imaging: Imaging, grid: FieldGrid, images: NDArray[np.float32]) -> PsfField:
    """The pair over the field, from images of shape (2 n_field_y n_field_x, n_depth, n, n)."""
    t_x, t_y = grid
    n_depth, n_y, n_x = images.shape[1:]
    stack = images.reshape(2, t_y.size, t_x.size, n_depth, n_y, n_x)
    centres = np.array([[[imaging.image_point_um(p, (x, y)) for x in t_x] for y in t_y] for p in (0, 1)])
    centres = np.repeat(centres[:, None], n_depth, axis=1)
    return PsfField(t_x, t_y, np.ascontiguousarray(np.moveaxis(stack, 3, 1)), centres)
