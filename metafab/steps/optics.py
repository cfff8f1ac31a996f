"""PSF pairs of the written file and of the target phases."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.storage.files import file_sha256, fingerprint
from metafab.core.storage.latest import Latest, file_mark
from metafab.core.storage.provenance import contents_sha256
from metafab.spec import Design, Scene
from metafab.steps.job import Job, Step
from metafab.steps.layout import mask_paths
from metafab.steps.library import library_path, open_library
from metafab.steps.outputs import in_folder

if TYPE_CHECKING:
    from metafab.layout import PillarMap
    from metafab.optics import Imaging, Psf, Source, WrittenField


_READ: Latest[PillarMap] = Latest()

#: The decoder's calibration reaches beyond the scene by this share of its range of vergence.
DEPTH_MARGIN = 0.08
#: The same for a scene at one depth, as a share of its vergence.
SMALLEST_MARGIN = 0.02


def calibration_depths(design: Design, imaging: Imaging) -> tuple[float, ...]:
    """Depths of the PSF stack: the verified ones, and nodes that carry a scene's range by interpolation."""
    from metafab import optics

    if design.scene is None:
        return design.verify.depths_m
    near, far = 1.0 / design.depths_m[0], 1.0 / design.depths_m[-1]
    margin = max(DEPTH_MARGIN * (near - far), SMALLEST_MARGIN * near)
    farthest_m = 1.0 / (far - margin) if far > margin else math.inf
    nodes = optics.depth_nodes(imaging, 1.0 / (near + margin), farthest_m, design.verify.target_error)
    return tuple(sorted({*design.verify.depths_m, *(float(z) for z in nodes)}))


def mask_source(job: Job, path: Path, copy: int = 1, angles: int | None = None) -> WrittenField:
    """What light the pillars of a written file let through; of several lenses, those of one, counted from 1.

    Steps that follow each other share the pillars as long as file and design are the same. ``angles`` is the number of
    angles in half a turn that turned pillars may have; None for upright pillars.

    Raises:
        InputError: the file cannot be read, or holds shapes that are no pillars of the lattice: nothing is dropped.
    """
    from metafab import optics

    if path.is_file():
        key = (file_mark(path), fingerprint(job.design), copy, angles)
        standing = _READ.of(key, lambda: _standing_pillars(job, path, copy, angles))
    else:
        standing = _standing_pillars(job, path, copy, angles)
    return optics.written_field(standing, open_library(job))


def _standing_pillars(job: Job, path: Path, copy: int, angles: int | None) -> PillarMap:
    """The pillars of a file, without the bias that they are drawn with."""
    from metafab import mask
    from metafab.mask.turned import read_turned

    if angles is None:
        back = mask.read(path, job.design, progress=job.progress, copy=copy)
    else:
        back = read_turned(path, job.design, angles, progress=job.progress, copy=copy)
    unplaced = {
        "off the lattice": back.off_site.count,
        "off the grid": back.off_grid.count,
        "at a site that has one already": back.duplicates.count,
        **{kind: left.count for kind, left in back.foreign.items()},
    }
    if any(unplaced.values()):
        raise InputError.single(
            str(path),
            "pillars",
            "rectangles at lattice sites and nothing else on the pillar layer",
            ", ".join(f"{count} {what}" for what, count in unplaced.items() if count),
            "their light cannot be simulated; `metafab drc` says where they are",
        )
    return mask.biased(back.pillars, -job.design.mask.bias_nm)


def ideal_source(job: Job) -> Source:
    """What light the target phases would let through, without a mask."""
    from metafab import layout, optics

    design = job.design
    lattice = layout.lattice_of(design) if design.has_mask else layout.sampling_lattice(job.profile, design)
    return optics.ideal_field(job.profile, lattice, design.device)


def lit_source(job: Job, source: Source) -> Source:
    """The source behind the stop and the amplitude that the design puts before it."""
    from metafab import optics

    return optics.apodised(source, optics.Apodisation.of(job.design))


def filter_fwhm_nm(design: Design) -> float | None:
    """Width of the filter before the sensor; None for one wavelength."""
    return None if design.optics is None else design.optics.filter_fwhm_nm


def point_spread(
    job: Job,
    path: Path | None,
    *,
    depths_m: tuple[float, ...],
    object_mm: tuple[float, float],
    pixel_um: float | None,
    window_px: int,
    target_error: float,
    copy: int = 1,
) -> Psf:
    """PSF pair of a written file's lens ``copy``, or of the target phases where ``path`` is None."""
    from metafab import optics

    imaging = optics.Imaging.of(job.design)
    if pixel_um is not None:
        imaging = replace(imaging, pixel_um=pixel_um)
    source = _source_of(job, path, copy)
    # On the axis, all depths lie in one direction and share one pass over the pillars.
    x_mm, y_mm = object_mm
    if (x_mm, y_mm) != (0.0, 0.0) and math.inf in depths_m:
        raise InputError.single(
            "psf", "--object-mm", "an object at a finite depth", f"{x_mm:g} {y_mm:g} mm at infinity",
            "leave inf out of --depths-m: a place beside the axis in mm is no direction there",
        )  # fmt: skip
    together = [depths_m] if x_mm == y_mm == 0.0 else [(depth,) for depth in depths_m]
    stacks = [
        optics.psf(
            source, imaging, depths, tangent=(1e-3 * x_mm / depths[0], 1e-3 * y_mm / depths[0]),
            window_px=window_px, target_error=target_error, filter_fwhm_nm=filter_fwhm_nm(job.design),
            workers=job.workers, cluster=job.cluster, progress=job.progress,
        )
        for depths in together
    ]  # fmt: skip
    return optics.concatenate(stacks)


def save_psf(job: Job, psf: Psf, mask_path: Path | None, path: Path, copy: int = 1) -> None:
    """Keep a PSF pair with the fingerprint of the mask's lens (None for target phases) and the design behind it."""
    from metafab import optics

    design = job.design
    source = design.phase if mask_path is None else [file_sha256(mask_path), file_sha256(library_path(job)), copy]
    asked: list[Any] = [psf.depth_m, psf.centre_um, psf.pixel_um, psf.psf.shape, psf.sensor_distance_um]
    if design.optics is not None:
        asked += [design.optics, contents_sha256(design.optics)]
    optics.save(psf, path, inputs_sha256=fingerprint(source, design.device, design.sensor, asked))


def _depth_interpolation_error(written: Psf, shown: np.ndarray) -> float | None:
    """PSFs at the shown depths that lie between the others, interpolated from these, against the computed ones."""
    from metafab import optics

    others = written.depth_m[~shown]
    between = shown & (written.depth_m > others.min(initial=math.inf)) & (written.depth_m < others.max(initial=0.0))
    if not between.any():
        return None
    interpolated = optics.at_depths(optics.without_depths(written, shown), written.depth_m[between])
    return optics.relative_l2(interpolated, written.psf[:, between])


def _field_interpolation_error(written: Psf, point_spread_of: Callable[..., Psf], source: Source) -> float | None:
    """Interpolated PSFs in the middle of an outermost cell of field points against computed ones."""
    from metafab import optics

    if written.field is None or min(written.field.tangent_x.size, written.field.tangent_y.size) == 1:
        return None
    middle = written.depth_m.size // 2
    t_x, t_y = (float(nodes[-2:].mean()) for nodes in (written.field.tangent_x, written.field.tangent_y))
    computed = point_spread_of(source, depths_m=written.depth_m[middle : middle + 1], tangent=(t_x, t_y))
    return optics.relative_l2(optics.at_tangent(written, (t_x, t_y))[:, middle : middle + 1], computed.psf)


def psf_figures(psf: Psf) -> dict[str, FloatArray]:
    """The PSF pair's figures of merit, one array over depth each."""
    return {
        "depth_m": psf.depth_m,
        "phi_deg": psf.phi_deg,
        "efficiency_x": psf.efficiency[0],
        "efficiency_y": psf.efficiency[1],
        "extinction_ratio": psf.extinction_ratio,
        "error": psf.error,
    }


def power_figures(psf: Psf) -> dict[str, float | str]:
    """Shares of the power at the aperture, of the stack's middle depth: transmitted, thereof stray, and lost."""
    return {name: value for name, value in psf.details.items() if name.startswith(("transmitted_", "stray_", "lost_"))}


def _psf_files(job: Job) -> tuple[Path, ...]:
    """Without a mask, the pair of the target phases is the pair."""
    return in_folder("psf.h5", *(("ideal_psf.h5",) if job.design.has_mask else ()))(job)


def _as_verified(job: Job) -> Callable[..., Psf]:
    """PSFs of a source by the design's window and target error."""
    from metafab import optics

    verify = job.design.verify
    return partial(
        optics.psf,
        imaging=optics.Imaging.of(job.design),
        window_px=verify.window_px,
        target_error=verify.target_error,
        filter_fwhm_nm=filter_fwhm_nm(job.design),
        workers=job.workers,
        cluster=job.cluster,
        progress=job.progress,
    )


def _calibration(job: Job, source: Source) -> Psf:
    """The pair over all depths and directions of the design's scene."""
    from metafab import optics

    imaging = optics.Imaging.of(job.design)
    return _as_verified(job)(
        source,
        depths_m=calibration_depths(job.design, imaging),
        field_tangents=optics.field_tangents(job.design, imaging),
    )


def calibration(job: Job, path: Path | None, *, copy: int = 1) -> Psf:
    """The pair of a written file (None: of the target phases) over depth and field, as a run hands it to the decoder.

    Raises:
        InputError: the design has no scene, whose depths and field these are.
    """
    if job.design.scene is None:
        raise InputError.single(job.design.name, "scene", "one, whose depths and field are covered", "none", "add it")
    return _calibration(job, _source_of(job, path, copy))


def exact_pair(job: Job, path: Path | None, scene: Scene, *, copy: int = 1) -> Psf:
    """The pair at one scene's very depths, over as many directions as it takes.

    Frames made with it share no approximation with a calibration.

    Args:
        job: the design, without its scene.
        path: of a written file; None for the target phases.
        scene: what is to be photographed, in all of its frames.
        copy: which lens of the file.
    """
    from metafab import camera, optics

    return camera.exact_psf(
        scene, _source_of(job, path, copy), optics.Imaging.of(job.design),
        filter_fwhm_nm=filter_fwhm_nm(job.design), progress=job.progress,
    )  # fmt: skip


def _source_of(job: Job, path: Path | None, copy: int) -> Source:
    return lit_source(job, ideal_source(job) if path is None else mask_source(job, path, copy))


def _psf(job: Job) -> dict[str, Any]:

    design = job.design
    point_spread_of = _as_verified(job)
    ideal_light = lit_source(job, ideal_source(job))
    mask_path = mask_paths(job)[-1] if design.has_mask else None
    source = ideal_light if mask_path is None else lit_source(job, mask_source(job, mask_path))
    written = _calibration(job, source)
    save_psf(job, written, mask_path, job.folder / "psf.h5")
    figures = {}
    if design.has_mask:
        ideal = point_spread_of(ideal_light, depths_m=design.verify.depths_m)
        save_psf(job, ideal, None, job.folder / "ideal_psf.h5")
        figures = {f"ideal_{name}": value for name, value in psf_figures(ideal).items() if name != "depth_m"}
    shown = np.isin(written.depth_m, design.verify.depths_m)
    return {
        **{name: value[shown] for name, value in psf_figures(written).items()},
        **figures,
        "depth_interpolation_error": _depth_interpolation_error(written, shown),
        "field_interpolation_error": _field_interpolation_error(written, point_spread_of, source),
        "depths": written.depth_m.size,
        **written.details,
    }


PSF = Step(
    "psf", ("mask", "optics"), ("library", "phase", "layout"),
    lambda d: (d.sensor, d.verify, d.scene and d.scene.field_px, d.depths_m, d.optics, d.has_mask),
    _psf_files, _psf,
)  # fmt: skip
