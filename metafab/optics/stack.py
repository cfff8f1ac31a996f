"""Compute the PSF pair over depth and field: choose the pupil blocks, propagate to each window, add up the power."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metafab.core.arguments import is_several, require_types
from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.parallel.executor import one_blas_thread
from metafab.core.parallel.work import Work
from metafab.layout.pillars import PillarMap
from metafab.optics.geometry.imaging import FieldGrid, Imaging, Tangent
from metafab.optics.geometry.path import JonesEntry, Ray, power_at_aperture
from metafab.optics.interpolation import at_tangent
from metafab.optics.measures.metrics import orientation_deg
from metafab.optics.numerics import PsfNumerics, require_valid
from metafab.optics.point_spread import Psf, PsfDetails, PsfField
from metafab.optics.propagation.blocks import reduce_to_target
from metafab.optics.propagation.image import Judged, Window, relative_l2
from metafab.optics.propagation.pupil import Pupil
from metafab.optics.sources.oblique import from_direction, neighbour_map_of
from metafab.optics.sources.source import Source

#: Irradiance over depth in a window, shape (n_depth, n_y, n_x), and the error of each judged depth.
_WindowLight = tuple[FloatArray, FloatArray]


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
    require_types("optics", imaging=(imaging, Imaging), numerics=(numerics, PsfNumerics))
    if isinstance(source, PillarMap) or not hasattr(source, "lattice"):
        expected = "light, such as a WrittenField or an IdealField"
        remedy = "`written_field` gives that of pillars and their library, `ideal_field` that of target phases"
        raise InputError.single("optics", "source", expected, type(source).__name__, remedy)
    if not is_several(depths_m) or np.ndim(depths_m) > 1:
        expected = f"a sequence of depths, such as [{depths_m}]"
        raise InputError.single("optics", "depths_m", expected, f"{depths_m}")
    depths = [float(z) for z in depths_m]
    grid = None if field_tangents is None else _grid(field_tangents)
    require_valid(imaging, depths, tangent, grid, numerics)
    source = from_direction(source, tangent, grid)
    with one_blas_thread(), work.threads() as pool:
        windows = Window.for_target(imaging, numerics).over_band(tangent, numerics.filter_fwhm_nm)
        pyramids, stray = reduce_to_target(source, windows, depths, tangent, grid, numerics.block_error, pool, work)
        light = _window_light(_WindowInputs(imaging, pyramids, stray, depths, numerics), tangent, grid, pool, work)

    transmitted = [_transmitted(imaging, pyramids, p, depths[len(depths) // 2], tangent) for p in (0, 1)]
    pairs = [
        _pair(imaging, depths, tangent, images, errors, None if grid is None else (grid, part))
        for images, errors, part in zip(light.images, light.errors, light.over_field, strict=True)
    ]
    wanted, ghost = pairs[0], pairs[1] if len(pairs) > 1 else None
    unwanted = light.unwanted if ghost is None else light.unwanted + ghost.efficiency[0]
    pupil = pyramids[0][0]
    details = PsfDetails(
        block_sites=pupil.carrier.block_sites,
        blocks=pupil.power.size,
        transmitted=tuple(transmitted),
        stray=tuple(share - float(wanted.efficiency[p, len(depths) // 2]) for p, share in enumerate(transmitted)),
        field_error=light.field_error,
        field_interpolation_error=light.interpolation_error(wanted, grid),
        filter_fwhm_nm=numerics.filter_fwhm_nm,
        seconds=time.perf_counter() - begun,
    )
    return replace(
        wanted,
        extinction_ratio=_extinction_ratio(wanted, unwanted),
        ghost=ghost,
        details=details,
        aperture_um=pupil.sub_apertures_um,
        neighbours=neighbour_map_of(source),
    )


@dataclass(frozen=True)
class _WindowInputs:
    """Block sums, depths and numerics that the light of every window is computed from."""

    imaging: Imaging
    pyramids: list[list[Pupil]]  # of each polarisation: block sums, then those of ever coarser blocks
    stray: Pupil  # block sums of y polarised light for the window of x
    depths_m: list[float]
    numerics: PsfNumerics

    @property
    def entries(self) -> list[JonesEntry]:
        """Polarisations of window (and pillars) and of the object, 0 for x: the pair, and with a crystal its ghosts."""
        return [(0, 0), (1, 1)] if self.imaging.crystal is None else [(0, 0), (1, 1), (0, 1), (1, 0)]


@dataclass(frozen=True)
class _Light:
    """Irradiance in all windows; the first axis of the lists is the pair, then its ghosts if there are any."""

    images: list[list[FloatArray]]  # of x and y on the direction of the pair, shape (n_depth, n_y, n_x) each
    errors: list[list[FloatArray]]  # relative L2 errors of `images`, shape (n_depth,) each
    over_field: NDArray[np.float32]  # shape (n_pairs, 2 n_field_y n_field_x, n_depth, n_y, n_x)
    field_error: float  # the largest over the field; NaN without one
    between: list[FloatArray]  # of x and y at the middle depth between the last nodes of the field; empty without one
    unwanted: FloatArray  # shape (n_depth,), power of the other polarisation in the window of PSF_x

    def interpolation_error(self, wanted: Psf, grid: FieldGrid | None) -> float:
        """Relative L2 error of the pair interpolated between the nodes of the field; NaN without a field."""
        probe, middle = _between_nodes(grid), wanted.depth_m.size // 2
        if probe is None:
            return float("nan")
        return relative_l2(at_tangent(wanted, probe)[:, middle : middle + 1], np.array(self.between))


def _window_light(
    inputs: _WindowInputs, tangent: Tangent, grid: FieldGrid | None, pool: Executor, work: Work
) -> _Light:
    """Add up the light of the pair at ``tangent`` and at all nodes of ``grid``, a window at a time."""
    depths, numerics, entries = inputs.depths_m, inputs.numerics, inputs.entries
    window, probe = Window.for_target(inputs.imaging, numerics), _between_nodes(grid)
    nodes = [] if grid is None else [(float(t_x), float(t_y)) for t_y in grid[1] for t_x in grid[0]]
    tasks = [(entry, tangent) for entry in entries] + [(entry, node) for entry in entries for node in nodes]

    def submitted(entry: JonesEntry, at: Tangent, depths_m: list[float], judged: Judged) -> Future[_WindowLight]:
        pupils = inputs.pyramids[entry[0]]
        return pool.submit(Window.light, window, pupils, entry[0], at, depths_m, numerics, judged=judged, entry=entry)

    unwanted = pool.submit(Window.stray_irradiance, window, inputs.stray, 0, tangent, depths)
    jobs = [submitted(*task, depths, "all" if k < len(entries) else "ends") for k, task in enumerate(tasks)]
    central = depths[len(depths) // 2 :][:1]
    checks = [] if probe is None else [submitted((p, p), probe, central, "none") for p in (0, 1)]
    images: list[FloatArray] = []
    errors: list[FloatArray] = []
    for done, job in enumerate(jobs):
        image, error = job.result()
        images.append(image if done < len(entries) else image.astype(np.float32))
        errors.append(error)
        work.progress("psf", done + 1, len(tasks))
    over_field = np.array(images[len(entries) :], dtype=np.float32)
    pairs = range(0, len(entries), 2)
    return _Light(
        images=[images[i : i + 2] for i in pairs],
        errors=[errors[i : i + 2] for i in pairs],
        over_field=over_field.reshape(len(pairs), -1, *over_field.shape[1:]),
        field_error=float(max(error.max() for error in errors[len(entries) :])) if nodes else float("nan"),
        between=[job.result()[0] for job in checks],
        unwanted=unwanted.result().sum(axis=(1, 2)) * inputs.imaging.pixel_um**2,
    )


def _extinction_ratio(wanted: Psf, unwanted: FloatArray) -> FloatArray:
    """Wanted over unwanted power in the window of PSF_x, shape (n_depth,); NaN where one window holds both PSFs."""
    if np.abs(np.diff(wanted.centre_um[:, 0], axis=0)).max() < wanted.pixel_um:
        return np.full(wanted.depth_m.shape, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(wanted.efficiency[0] / unwanted)


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


def _between_nodes(grid: FieldGrid | None) -> Tangent | None:
    """Middle of an outermost cell of the field grid, where interpolation errs most; None where cells have no area."""
    if grid is None:
        return None
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
