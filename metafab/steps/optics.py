"""PSF pairs of the written mask and of the target phases.

In all functions ``path`` is a mask file, or None for the target phases. ``copy`` is the number of the lens in a file
that holds several, from 1. ``printed`` says which pillars ``[process]`` makes; None for those of the file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.parallel.work import Work
from metafab.core.storage.files import file_sha256, fingerprint, plain
from metafab.core.storage.latest import Latest, file_mark
from metafab.core.storage.provenance import contents_sha256
from metafab.core.storage.tables import optional, typed
from metafab.spec import Design, Scene
from metafab.steps.exposure import Printed, made_mask
from metafab.steps.job import Job, Step, in_folder
from metafab.steps.layout import mask_paths
from metafab.steps.library import library_path, open_library

if TYPE_CHECKING:
    from metafab.layout import PillarMap
    from metafab.optics import Imaging, NeighbourField, Psf, Source, WrittenField
    from metafab.optics.measures.landing import Places

#: Share of the target error that remains to blocks of the pupil and to depths where nothing is to be left out.
UNSKIPPED_SHARE = 0.1
#: The pillars that were read last, shared by the steps of a run.
_READ: Latest[PillarMap] = Latest()
#: Their field among neighbours, solved once for all steps of a run.
_AMONG: Latest[NeighbourField] = Latest()

#: Margin of the decoder's calibration beyond the scene, as a share of the scene's range of vergence.
DEPTH_MARGIN = 0.08
#: Smallest margin, as a share of the nearest object's vergence; it serves scenes at one depth.
SMALLEST_MARGIN = 0.02


@dataclass(frozen=True, kw_only=True)
class PairFigures:
    """Figures of a PSF pair over depth, and the power budget at its middle depth."""

    depth_m: tuple[float, ...]  #: Object depths; the next five hold one value for each of them.
    phi_deg: tuple[float, ...]  #: Orientation of the main lobe of PSF_x, degrees counter-clockwise from +x.
    #: Share of the power at the aperture in the window of PSF_x; likewise ``efficiency_y``.
    efficiency_x: tuple[float, ...]
    efficiency_y: tuple[float, ...]
    extinction_ratio: tuple[float, ...]  #: Wanted over unwanted power in the window of PSF_x.
    error: tuple[float, ...]  #: Relative L2 error of the PSFs.
    #: Share of y polarised power that a birefringent substrate brings into the window of PSF_x, one value for each
    #: depth; likewise ``ghost_y``. None without such a substrate.
    ghost_x: tuple[float, ...] | None = optional()
    ghost_y: tuple[float, ...] | None = optional()
    #: Share of the power at the aperture that the mask transmits; ``stray_x``: transmitted share outside the window;
    #: ``lost_x``: share not transmitted. Likewise for y; None for a pair without a budget.
    transmitted_x: float | None = optional()
    stray_x: float | None = optional()
    lost_x: float | None = optional()
    transmitted_y: float | None = optional()
    stray_y: float | None = optional()
    lost_y: float | None = optional()
    #: (x, y) on the sensor, from the axis, of the brightest place of x and of y polarised light; None where the windows
    #: hold the light.
    light_at_um: tuple[tuple[float, ...], ...] | None = optional()
    #: True where the brightest pixel of a polarisation lies on the edge of its window, else None.
    peak_on_edge: bool | None = optional()
    #: Rms error of the amplitudes of made pillars over their rms, beside ``error``; None for those of the file.
    made_error: float | None = optional()

    @classmethod
    def of(cls, psf: Psf, light_at_um: Places | None = None) -> PairFigures:
        """Figures of all depths of a pair."""
        table = {**_over_depth(psf, np.ones(psf.depth_m.size, dtype=bool)), **plain(psf.details.figures())}
        return replace(typed(cls, table), light_at_um=light_at_um, peak_on_edge=_on_edge(psf))

    @property
    def is_whole(self) -> bool:
        """Whether the windows hold the maxima of the light, as far as is known."""
        return self.light_at_um is None and not self.peak_on_edge

    def warnings(self) -> list[str]:
        """Return a sentence with the place of the light and the remedy, where a window misses the light or cuts it."""
        if self.light_at_um is None:
            return [] if self.is_whole else [self._cut()]
        (x, y), (x_2, y_2) = self.light_at_um
        place = f"({x:.4g}, {y:.4g})" if (x, y) == (x_2, y_2) else f"({x:.4g}, {y:.4g}) and ({x_2:.4g}, {y_2:.4g})"
        return [
            f"the window misses the light: most of it lands about {place} um from the axis (x and y polarisation). "
            "Place the window there with `verify.centre_um = [x, y]` (`metafab psf --centre-um X Y`), or widen it with "
            "`verify.window_px`"
        ]

    def _cut(self) -> str:
        middle = len(self.depth_m) // 2
        shares = [
            100.0 * efficiency[middle] / transmitted
            for efficiency, transmitted in (
                (self.efficiency_x, self.transmitted_x),
                (self.efficiency_y, self.transmitted_y),
            )
            if transmitted
        ]
        held = f", which holds {min(shares):.2g} % of the transmitted light" if shares else ""
        return (
            f"the brightest pixel lies on the edge of the window{held}: lobe, widths and shares are those of a part of "
            "the image. Widen the window with `verify.window_px` (`metafab psf --window-px N`), or move it with "
            "`verify.centre_um = [x, y]` (`--centre-um X Y`)"
        )


def _on_edge(psf: Psf) -> bool | None:
    from metafab.optics.measures.metrics import peak_on_edge

    return peak_on_edge(psf) or None


@dataclass(frozen=True, kw_only=True)
class PsfFigures(PairFigures):
    """Figures of the pair of a run at the verified depths, compared with the target phases."""

    #: Relative L2 error of PSFs interpolated over depth; None where no verified depth lies between other depths.
    depth_interpolation_error: float | None
    #: Relative L2 error of PSFs interpolated over the field; None without a field.
    field_interpolation_error: float | None
    depths: int  #: Depths of the stored pair.
    #: Lattice sites along the side of a block of the pupil; ``blocks``: number of blocks. These and the following are
    #: None for a pair that was not computed by :func:`metafab.optics.psf`.
    block_sites: float | None = optional()
    blocks: float | None = optional()
    field_error: float | None = optional()  #: Relative L2 error of the PSFs over the field; NaN without a field.
    #: This and the other names that begin with ``ideal_`` are the figures of the target phases, one value for each
    #: depth; None without a mask, where the pair itself is that of the target phases.
    ideal_phi_deg: tuple[float, ...] | None = optional()
    ideal_efficiency_x: tuple[float, ...] | None = optional()
    ideal_efficiency_y: tuple[float, ...] | None = optional()
    ideal_extinction_ratio: tuple[float, ...] | None = optional()
    ideal_error: tuple[float, ...] | None = optional()
    filter_fwhm_nm: float | None = optional()  #: Width of the colour filter; None for one wavelength.
    #: True where the library's model of unlike neighbours gave the light of the pillars, else None.
    with_neighbours: bool | None = optional()
    #: Relative rms change of the pillars' light from the corner of the field, which comes at an angle; None without a
    #: field, and where it was not solved (:func:`metafab.library.use.oblique_error.oblique_field_error`).
    oblique_error: float | None = optional()

    @classmethod
    def compared(
        cls,
        psf: Psf,
        ideal: Psf | None,
        *,
        verified: NDArray[np.bool_],
        depth_interpolation_error: float | None = None,
        light_at_um: Places | None = None,
    ) -> PsfFigures:
        """Figures of a pair and of the target phases (None without a mask) at the verified depths.

        ``verified``, shape (n_depth,), marks these among the depths of ``psf``.
        """
        of_target = {} if ideal is None else _over_depth(ideal, np.ones(ideal.depth_m.size, dtype=bool), "ideal_")
        table = {
            **_over_depth(psf, verified),
            **of_target,
            "depth_interpolation_error": depth_interpolation_error,
            "field_interpolation_error": None,  # until the details say more
            "depths": psf.depth_m.size,
            **plain(psf.details.figures()),
        }
        return replace(typed(cls, table), light_at_um=light_at_um, peak_on_edge=_on_edge(psf))


def _over_depth(psf: Psf, chosen: NDArray[np.bool_], prefix: str = "") -> dict[str, list[float]]:
    """Table of the figures over depth, at the chosen depths."""
    columns: dict[str, FloatArray] = {
        "depth_m": psf.depth_m,
        "phi_deg": psf.phi_deg,
        "efficiency_x": psf.efficiency[0],
        "efficiency_y": psf.efficiency[1],
        "extinction_ratio": psf.extinction_ratio,
        "error": psf.error,
    }
    if psf.ghost is not None and not prefix:
        columns |= {"ghost_x": psf.ghost.efficiency[0], "ghost_y": psf.ghost.efficiency[1]}
    return {prefix + name: values[chosen].tolist() for name, values in columns.items()}


def calibration_depths(design: Design, imaging: Imaging, target_error: float | None = None) -> tuple[float, ...]:
    """Depths of the PSF stack: the verified depths, and interpolation nodes over the range of the scene.

    ``target_error`` is the largest relative L2 error of interpolation; that of ``[verify]`` by default.
    """
    from metafab import optics

    if design.scene is None:
        return design.verify.depths_m
    near, far = 1.0 / design.depths_m[0], 1.0 / design.depths_m[-1]
    margin = max(DEPTH_MARGIN * (near - far), SMALLEST_MARGIN * near)
    farthest_m = 1.0 / (far - margin) if far > margin else math.inf
    nodes = optics.depth_nodes(imaging, 1.0 / (near + margin), farthest_m, target_error or design.verify.target_error)
    return tuple(sorted({*design.verify.depths_m, *(float(z) for z in nodes)}))


def mask_source(job: Job, path: Path, copy: int = 1, angles: int | None = None) -> WrittenField:
    """Transmitted field of the pillars of a written file.

    Consecutive steps share the pillars as long as file and design are unchanged. ``angles`` is the number of angles of
    turned pillars in half a turn; None for upright pillars. InputError if the file cannot be read, or holds shapes that
    are no pillars of the lattice.
    """
    from metafab import optics

    if path.is_file():
        key = _pillars_key(job, path, copy, angles)
        pillars = _READ.of(key, lambda: _read_pillars(job, path, copy, angles))
    else:
        pillars = _read_pillars(job, path, copy, angles)
    return optics.written_field(pillars, open_library(job))


def written_light(job: Job, path: Path, copy: int = 1) -> WrittenField | NeighbourField:
    """Transmitted field of the pillars of a written file, among their neighbours if design and library say so.

    ``[optics] neighbours`` decides; without it, the library's model is used if it has one that lowers the error. Errors
    as :func:`mask_source`; the design asks for neighbours that the library has no model of.
    """
    from metafab import optics

    lone = mask_source(job, path, copy)
    asked, library = job.design.optics and job.design.optics.neighbours, open_library(job)
    pays = library.neighbours is not None and library.neighbours.pays
    if asked is False or (asked is None and not pays):
        return lone
    if job.nominal is not None:  # a library evaluated at another wavelength or angle, which no file holds
        return optics.neighbour_field(lone.pillars, library, job.work.workers)
    key = _pillars_key(job, path, copy, None), file_mark(library_path(job))
    return _AMONG.of(key, lambda: optics.neighbour_field(lone.pillars, library, job.work.workers))


def _pillars_key(job: Job, path: Path, copy: int, angles: int | None) -> Hashable:
    """Key of the pillars of a written file: file, design, number of the lens, and angles of turned pillars."""
    return file_mark(path), fingerprint(job.design), copy, angles


def _read_pillars(job: Job, path: Path, copy: int, angles: int | None) -> PillarMap:
    """Pillars of a file, without the bias with which they are drawn."""
    from metafab import mask
    from metafab.mask.turned import read_turned

    progress = job.work.progress
    if angles is None:
        back = mask.read_shared(path, job.design, progress, copy)
    else:
        back = read_turned(path, job.design, angles, progress=progress, copy=copy)
    back.require_pillars_alone("their light cannot be simulated; `metafab drc` lists their places")
    return mask.biased(back.pillars, -job.design.mask.bias_nm)


def ideal_source(job: Job) -> Source:
    """Transmitted field of the target phases, without a mask."""
    from metafab import layout, optics

    design = job.design
    lattice = layout.lattice_of(design) if design.has_mask else layout.sampling_lattice(job.profile, design)
    return optics.ideal_field(job.profile, lattice, design.device)


def lit_source(job: Job, source: Source) -> Source:
    """Apply the stop and the apodisation of the design to a source."""
    from metafab import optics

    return optics.apodised(source, optics.Apodisation.of(job.design))


def filter_fwhm_nm(design: Design) -> float | None:
    """Width of the colour filter in front of the sensor; None for one wavelength."""
    return None if design.optics is None else design.optics.filter_fwhm_nm


def point_spread(
    job: Job,
    path: Path | None,
    *,
    depths_m: tuple[float, ...] | None = None,
    object_mm: tuple[float, float] = (0.0, 0.0),
    pixel_um: float | None = None,
    window_px: int | None = None,
    target_error: float | None = None,
    copy: int = 1,
    centre_um: tuple[float, float] | None = None,
    printed: Printed | None = None,
    sizes: Path | None = None,
    tangent: tuple[float, float] | None = None,
) -> tuple[Psf, Places | None]:
    """PSF pair of a written file, or of the target phases, and where its light is if a window misses it.

    Args:
        path: the mask file; None for the target phases.
        depths_m: object depths in increasing order; None for those of ``[verify]``, as for the window and the error.
        object_mm: object position (x, y), mm from the axis.
        pixel_um: sampling step; None for the pixel of the sensor.
        window_px: side of the window, pixels.
        target_error: largest relative L2 error.
        copy: number of the lens in a file that holds several, from 1.
        centre_um: centre of the window on the sensor, um from the axis; None for the image point of the design.
        printed: pillars as ``[process]`` makes them; None for those of the file.
        sizes: table of measured sizes (:func:`metafab.optics.sources.measured.with_measured_sizes`); None for none.
        tangent: direction (x/z, y/z) of the object at every depth, in place of ``object_mm``.

    Raises:
        InputError: a file cannot be used, or an object at infinity has a position.
    """
    from metafab import optics
    from metafab.optics.interpolation import concatenate
    from metafab.optics.measures.landing import light_elsewhere
    from metafab.optics.numerics import require_valid

    imaging, verify = optics.Imaging.of(job.design), job.design.verify
    depths_m = verify.depths_m if depths_m is None else depths_m
    window_px = verify.window_px if window_px is None else window_px
    target_error = verify.target_error if target_error is None else target_error
    if pixel_um is not None:
        imaging = replace(imaging, pixel_um=pixel_um)
    if centre_um is not None:
        imaging = imaging.aimed_at(centre_um)
    x_mm, y_mm = object_mm
    if (x_mm, y_mm) != (0.0, 0.0) and math.inf in depths_m:
        expected = "an object at a finite depth"
        remedy = "leave inf out of --depths-m: a position in mm is no direction there"
        raise InputError.single("psf", "--object-mm", expected, f"{x_mm:g} {y_mm:g} mm at infinity", remedy)
    # On the axis, all depths lie in one direction and share one pass over the pillars.
    numerics = optics.PsfNumerics(
        window_px=window_px,
        target_error=target_error,
        filter_fwhm_nm=filter_fwhm_nm(job.design),
        vectorial=verify.vectorial,
    )
    passes = [depths_m] if x_mm == y_mm == 0.0 else [(depth,) for depth in depths_m]
    tangents = [tangent or (1e-3 * x_mm / depths[0], 1e-3 * y_mm / depths[0]) for depths in passes]
    for depths, direction in zip(passes, tangents, strict=True):
        require_valid(imaging, depths, direction, None, numerics)  # before the mask is read
    source, made_error = _source_of(job, path, copy, printed, sizes)
    stacks = [
        optics.psf(source, imaging, depths, numerics, tangent=tangent, work=job.work)
        for depths, tangent in zip(passes, tangents, strict=True)
    ]
    middle = len(passes) // 2
    return _stating(concatenate(stacks), made_error), light_elsewhere(source, imaging, stacks[middle], tangents[middle])


def calibration(job: Job, path: Path | None, *, copy: int = 1, printed: Printed | None = None) -> Psf:
    """PSF pair over the depths and the field of the design's scene, as a run computes it for the decoder.

    InputError if the design has no scene.
    """
    if job.design.scene is None:
        raise InputError.single(job.design.name, "scene", "one, whose depths and field are covered", "none", "add it")
    source, made_error = _source_of(job, path, copy, printed)
    return _stating(_calibration(job, source), made_error)


def scene_pair(job: Job, path: Path | None, scene: Scene, *, copy: int = 1, printed: Printed | None = None) -> Psf:
    """PSF pair at the exact depths and directions of a scene, in all of its frames, without interpolation over depth.

    The scene of the design is not used.
    """
    from metafab import camera, optics
    from metafab.camera.exact import EXACT

    (source, made_error), imaging = _source_of(job, path, copy, printed), optics.Imaging.of(job.design)
    numerics = replace(EXACT, filter_fwhm_nm=filter_fwhm_nm(job.design), vectorial=job.design.verify.vectorial)
    pair = camera.exact_psf(scene, source, imaging, numerics, work=Work(progress=job.work.progress))
    return _stating(pair, made_error)


def save_psf(
    job: Job,
    psf: Psf,
    mask_path: Path | None,
    path: Path,
    copy: int = 1,
    printed: Printed | None = None,
    sizes: Path | None = None,
) -> None:
    """Write a PSF pair with the fingerprint of its mask (None for target phases) and of the design."""
    from metafab import optics

    design = job.design
    source = design.phase if mask_path is None else [file_sha256(mask_path), file_sha256(library_path(job)), copy]
    if printed is not None:
        source = [source, printed, design.process]
    if sizes is not None:
        source = [source, file_sha256(sizes)]
    sampling: list[Any] = [psf.depth_m, psf.centre_um, psf.pixel_um, psf.psf.shape, psf.sensor_distance_um]
    if design.optics is not None:
        sampling += [design.optics, contents_sha256(design.optics)]
    if design.substrate is not None:
        sampling.append(design.substrate)
    if job.nominal is not None:
        sampling.append(design.wavelength_um)
    if job.light is not None and job.light.angles_deg:
        sampling.append(job.light.angles_deg)
    optics.save(psf, path, inputs_sha256=fingerprint(source, design.device, design.sensor, sampling))


def _measured_field(job: Job, path: Path, copy: int, sizes: Path) -> WrittenField:
    """Field of the pillars of a file with measured sizes."""
    from metafab.optics.sources.measured import with_measured_sizes
    from metafab.optics.sources.source import made_field

    library = open_library(job)
    return made_field(with_measured_sizes(mask_source(job, path, copy).pillars, sizes, library), library)


def _source_of(
    job: Job, path: Path | None, copy: int, printed: Printed | None, sizes: Path | None = None
) -> tuple[Source, float]:
    """Pillars and their light; relative error of the amplitudes of made pillars, NaN for others."""
    if path is None:
        return lit_source(job, ideal_source(job)), math.nan
    if sizes is not None:
        return lit_source(job, _measured_field(job, path, copy, sizes)), math.nan
    if printed is None:
        return lit_source(job, written_light(job, path, copy)), math.nan
    made = made_mask(job, path, printed, copy).field
    return lit_source(job, made.field), made.error


def _stating(psf: Psf, made_error: float) -> Psf:
    """The PSFs with the error of their pillars' amplitudes."""
    return replace(psf, details=replace(psf.details, made_error=made_error))


def _psf_error(job: Job) -> float:
    """Target error of PSFs; without savings, blocks and depths are those of a lower one."""
    return job.design.verify.target_error * (1.0 if job.skips else UNSKIPPED_SHARE)


def _verified_psf(job: Job) -> Callable[..., Psf]:
    """PSF computation with the window and the target error of the design's ``[verify]``."""
    from metafab import optics

    verify = job.design.verify
    return partial(
        optics.psf,
        imaging=optics.Imaging.of(job.design),
        numerics=optics.PsfNumerics(
            window_px=verify.window_px,
            target_error=_psf_error(job),
            filter_fwhm_nm=filter_fwhm_nm(job.design),
            vectorial=verify.vectorial,
        ),
        work=job.work,
    )


def _calibration(job: Job, source: Source) -> Psf:
    from metafab import optics

    imaging = optics.Imaging.of(job.design)
    return _verified_psf(job)(
        source,
        depths_m=calibration_depths(job.design, imaging, _psf_error(job)),
        field_tangents=optics.field_tangents(job.design, imaging),
    )


def _depth_interpolation_error(written: Psf, verified: NDArray[np.bool_]) -> float | None:
    """Relative L2 error at the verified depths of PSFs interpolated from the other depths."""
    from metafab import optics
    from metafab.optics.interpolation import without_depths

    others = written.depth_m[~verified]
    between = verified & (written.depth_m > others.min(initial=math.inf)) & (written.depth_m < others.max(initial=0.0))
    if not between.any():
        return None
    interpolated = optics.at_depths(without_depths(written, verified), written.depth_m[between])
    return optics.relative_l2(interpolated, written.psf[:, between])


def _psf_files(job: Job) -> tuple[Path, ...]:
    """Files of the step; without a mask, the pair of the target phases is the only one."""
    return in_folder("psf.h5", *(("ideal_psf.h5",) if job.design.has_mask else ()))(job)


def _psf(job: Job) -> PsfFigures:
    from metafab.optics import Imaging, NeighbourField
    from metafab.optics.measures.landing import light_elsewhere

    design, psf_of = job.design, _verified_psf(job)
    ideal_light = lit_source(job, ideal_source(job))
    mask_path = mask_paths(job)[-1] if design.has_mask else None
    pillars = None if mask_path is None else written_light(job, mask_path)
    source = ideal_light if pillars is None else lit_source(job, pillars)
    written = _calibration(job, source)
    save_psf(job, written, mask_path, job.folder / "psf.h5")
    ideal = None
    if design.has_mask:
        ideal = psf_of(ideal_light, depths_m=design.verify.depths_m)
        save_psf(job, ideal, None, job.folder / "ideal_psf.h5")
    verified = np.isin(written.depth_m, design.verify.depths_m)
    figures = PsfFigures.compared(
        written,
        ideal,
        verified=verified,
        depth_interpolation_error=_depth_interpolation_error(written, verified),
        light_at_um=light_elsewhere(source, Imaging.of(design), written),
    )
    return replace(
        figures,
        with_neighbours=isinstance(pillars, NeighbourField) or None,
        oblique_error=None if pillars is None else _oblique_error(job, pillars.pillars),
    )


def _oblique_error(job: Job, pillars: PillarMap) -> float | None:
    """Change of the pillars' light from the corner of the field; None without a field."""
    from metafab.library.use.oblique_error import oblique_field_error
    from metafab.optics.geometry.imaging import Imaging, field_corner

    corner = field_corner(job.design, Imaging.of(job.design))
    if corner is None:
        return None
    return oblique_field_error(open_library(job), pillars.size_nm(), pillars.numbers(), corner)


PSF = Step(
    name="psf",
    rooms=("cell", "library", "mask", "optics"),
    after=("library", "phase", "layout"),
    inputs=lambda d: (d.sensor, d.verify, d.scene and d.scene.field_px, d.depths_m, d.optics, d.substrate, d.has_mask),
    outputs=_psf_files,
    work=_psf,
    figures=PsfFigures,
)
