"""PSF pairs of the written mask and of the target phases, and the step ``psf``.

In all functions ``lens`` holds the pillars; None stands for the target phases.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from metafab.core.errors import InputError
from metafab.core.parallel.work import Work
from metafab.core.storage.files import file_sha256, fingerprint
from metafab.core.storage.provenance import contents_sha256
from metafab.spec import Design, Scene
from metafab.steps.job import Job, Step, in_folder
from metafab.steps.layout import mask_paths
from metafab.steps.library import library_path, neighbour_warning, open_library
from metafab.steps.optics.figures import PairFigures, PsfFigures
from metafab.steps.optics.sources import (
    WrittenLens,
    empty_share,
    ideal_source,
    joint_error,
    light_over_field,
    lit_source,
    oblique_error,
    source_of,
    written_light,
)

if TYPE_CHECKING:
    from metafab.optics import Imaging, Psf, Source
    from metafab.optics.measures.landing import Places

#: Factor on the target error of PSFs where no work is left out: for finer blocks of the pupil and more depths.
UNSKIPPED_SHARE = 0.1
#: Margin of the decoder's calibration beyond the scene, as a share of the scene's range of vergence.
DEPTH_MARGIN = 0.08
#: Smallest margin, as a share of the nearest object's vergence; it serves scenes at one depth.
SMALLEST_MARGIN = 0.02
#: What asks for the light of a model of neighbours that does not pay.
_LIT_BY = "`optics.neighbours`, by which the PSFs are computed"


def point_spread(
    job: Job,
    lens: WrittenLens | None,
    *,
    depths_m: tuple[float, ...] | None = None,
    object_mm: tuple[float, float] = (0.0, 0.0),
    pixel_um: float | None = None,
    window_px: int | None = None,
    target_error: float | None = None,
    centre_um: tuple[float, float] | None = None,
    tangent: tuple[float, float] | None = None,
) -> tuple[Psf, Places | None]:
    """PSF pair of a lens, or of the target phases, and where its light is if a window misses it.

    Args:
        depths_m: object depths in increasing order; None for those of ``[verify]``, as for the window and the error.
        object_mm: object position (x, y), mm from the axis.
        pixel_um: sampling step; None for the pixel of the sensor.
        window_px: side of the window, pixels.
        target_error: largest relative L2 error.
        centre_um: centre of the window on the sensor, um from the axis; None for the image point of the design.
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
    x_mm, y_mm = object_mm
    if (x_mm, y_mm) != (0.0, 0.0) and math.inf in depths_m:
        expected = "an object at a finite depth"
        remedy = "leave `inf` out of the depths: a position in mm is no direction there"
        raise InputError.single("psf", "object_mm", expected, f"{x_mm:g} {y_mm:g} mm at infinity", remedy)
    # On the axis, all depths lie in one direction and share one pass over the pillars.
    numerics = replace(optics.PsfNumerics.of(job.design), window_px=window_px, target_error=target_error)
    passes = [depths_m] if x_mm == y_mm == 0.0 else [(depth,) for depth in depths_m]
    tangents = [tangent or (1e-3 * x_mm / depths[0], 1e-3 * y_mm / depths[0]) for depths in passes]
    aimed = [imaging if centre_um is None else imaging.aimed_at(centre_um, tangent) for tangent in tangents]
    for towards, depths, direction in zip(aimed, passes, tangents, strict=True):
        require_valid(towards, depths, direction, None, numerics)  # before the mask is read
    source, made_error = source_of(job, lens, tangents=tangents)
    stacks = [
        optics.psf(source, towards, depths, numerics, tangent=tangent, work=job.work)
        for towards, depths, tangent in zip(aimed, passes, tangents, strict=True)
    ]
    middle = len(passes) // 2
    missed = light_elsewhere(source, aimed[middle], stacks[middle], tangents[middle])
    return _stating(concatenate(stacks), made_error), missed


def calibration(job: Job, lens: WrittenLens | None) -> Psf:
    """PSF pair over the depths and the field of the design's scene, as a run computes it for the decoder.

    InputError if the design has no scene.
    """
    if job.design.scene is None:
        raise InputError.single(job.design.name, "scene", "one, whose depths and field are covered", "none", "add it")
    source, made_error = source_of(job, lens)
    return _stating(_calibration(job, source), made_error)


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


def scene_pair(job: Job, lens: WrittenLens | None, scene: Scene) -> Psf:
    """PSF pair at the exact depths and directions of a scene, in all of its frames, without interpolation over depth.

    The scene of the design is not used.
    """
    from metafab import camera, optics
    from metafab.camera.exact import EXACT, scene_reach

    imaging = optics.Imaging.of(job.design)
    source, made_error = source_of(job, lens, tangents=[scene_reach(scene, imaging)])
    of_design = optics.PsfNumerics.of(job.design)
    numerics = replace(of_design, window_px=EXACT.window_px, target_error=EXACT.target_error)
    pair = camera.exact_psf(scene, source, imaging, numerics, work=Work(progress=job.work.progress))
    return _stating(pair, made_error)


def save_psf(job: Job, psf: Psf, lens: WrittenLens | None, path: Path) -> None:
    """Write a PSF pair with the fingerprint of its lens and of the design."""
    from metafab import optics

    design = job.design
    source: Any = design.phase
    if lens is not None:
        source = [file_sha256(lens.path), file_sha256(library_path(job)), lens.copy]
        if lens.printed is not None:
            source = [source, lens.printed, design.process]
        if lens.sizes is not None:
            source = [source, file_sha256(lens.sizes)]
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


def _stating(psf: Psf, made_error: float) -> Psf:
    """The PSFs with the error of their pillars' amplitudes."""
    return replace(psf, details=replace(psf.details, made_error=made_error))


def _psf_error(job: Job) -> float:
    """Target error of PSFs; a lower one where no work is left out, for finer blocks and more depths."""
    return job.design.verify.target_error * (1.0 if job.skips else UNSKIPPED_SHARE)


def _verified_psf(job: Job) -> Callable[..., Psf]:
    """PSF computation with the window and the target error of the design's ``[verify]``."""
    from metafab import optics

    numerics = replace(optics.PsfNumerics.of(job.design), target_error=_psf_error(job))
    return partial(optics.psf, imaging=optics.Imaging.of(job.design), numerics=numerics, work=job.work)


def pair_figures(
    job: Job, pair: Psf, light_at_um: Places | None = None, lens: WrittenLens | None = None
) -> PairFigures:
    """Figures of all depths of a pair of ``lens``, with their warnings; without a lens nothing is said of its file."""
    return replace(
        PairFigures.of(pair, light_at_um),
        neighbour_warning=_neighbour_warning(job, pair),
        empty_share=None if lens is None else empty_share(job, lens),
    )


def _neighbour_warning(job: Job, pair: Psf) -> str | None:
    """Sentence about a model of neighbours that gave the light of a pair and does not pay."""
    return None if pair.neighbours is None else neighbour_warning(open_library(job), _LIT_BY)


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
    from metafab.optics import Imaging
    from metafab.optics.measures.landing import light_elsewhere
    from metafab.optics.sources.oblique import ObliqueField

    design, psf_of = job.design, _verified_psf(job)
    ideal_light = lit_source(job, ideal_source(job))
    mask_path = mask_paths(job)[-1] if design.has_mask else None
    pillars = None if mask_path is None else written_light(job, mask_path)
    seen = None if pillars is None else light_over_field(job, pillars)
    source = ideal_light if seen is None else lit_source(job, seen)
    written = _calibration(job, source)
    save_psf(job, written, None if mask_path is None else WrittenLens(mask_path), job.folder / "psf.h5")
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
        with_neighbours=written.neighbours is not None or None,
        neighbour_warning=_neighbour_warning(job, written),
        joint_error=joint_error(job, pillars),
        oblique_error=None if seen is None else oblique_error(job, seen),
        oblique_change=seen.change.change if isinstance(seen, ObliqueField) else None,
    )


PSF = Step(
    name="psf",
    rooms=("cell", "library", "mask", "optics"),
    after=("library", "phase", "layout"),
    inputs=lambda d: (d.sensor, d.verify, d.scene and d.scene.field_px, d.depths_m, d.optics, d.substrate, d.has_mask),
    outputs=_psf_files,
    work=_psf,
    figures=PsfFigures,
)
