"""The steps of the main job, each a few lines: files in, files out, and its part of the summary.

The verification steps (``drc``, ``psf``) open the written mask; they never see the arrays of the design step.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from metafab import camera, decode, drc, fullwave, layout, library, mask, optics, phase
from metafab.camera import RawFrame
from metafab.core.conventions import FloatArray
from metafab.core.errors import Fault, InputError
from metafab.core.executor import open_executor
from metafab.core.files import file_sha256, fingerprint
from metafab.core.progress import Progress, silent
from metafab.decode import Image4D
from metafab.library import Library
from metafab.optics import Imaging, Psf
from metafab.run import Job, Step
from metafab.spec import Design, Scene

#: The decoder's calibration reaches beyond the scene by this share of its range of vergence.
DEPTH_MARGIN = 0.08
#: The same for a scene at one depth, as a share of its vergence.
SMALLEST_MARGIN = 0.02


# --- library ---------------------------------------------------------------------------------------------------


def library_path(job: Job) -> Path:
    """Where the built library lives: beside its unit-cell file, or in the run folder if that is read-only."""
    source = job.design.library
    if source.suffix == ".h5":
        return source
    built = source.with_suffix(".h5")
    return built if os.access(source.parent, os.W_OK) else job.folder / built.name


def library_stands(job: Job) -> bool:
    """Whether the design's library is there; if not, it is built before anything that needs it."""
    return job.design.library.suffix == ".h5" or library.is_current(library_path(job), job.design.unit_cell)


def open_library(job: Job) -> Library:
    """The design's library, built first when it is missing or was built from another unit cell."""
    path = library_path(job)
    if not library_stands(job):
        with open_executor(job.workers, job.cluster) as executor:
            return library.build_file(job.design.unit_cell, path, executor=executor, progress=job.progress)
    return library.load(path)


def _library(job: Job) -> dict[str, Any]:
    opened = open_library(job)
    return {
        "file": str(library_path(job)),
        **library.quality(opened),
        "index_phase_error_rad": library.index_phase_error_rad(opened),
        **opened.details,
    }


# --- phase and layout --------------------------------------------------------------------------------------------


def _phase(job: Job) -> dict[str, Any]:
    phase.save(job.profile, job.design, job.folder / "phase.h5")
    return dict(job.profile.figures)


def _study_inputs(design: Design) -> tuple[Any, ...]:
    illumination = design.unit_cell.illumination
    return (design.phase, design.device, design.sensor, illumination, design.depths_m, design.scene, design.optics)


def _study(job: Job) -> dict[str, Any]:
    found = phase.study(job.design, job.profile)
    phase.save_study(
        found, job.folder / "phase_study.h5", inputs_sha256=fingerprint(*_study_inputs(job.design), job.design.numerics)
    )
    return {} if found.bandwidth is None else {"bandwidth": phase.bandwidth_figures(found.bandwidth)}


def write_layout(job: Job) -> dict[str, Any]:
    """Map the target phases to pillars and write the mask files."""
    assignment = layout.assign(job.profile, open_library(job), job.design, progress=job.progress)
    files = mask.write(assignment.pillars, job.folder, job.design, progress=job.progress, mapping=assignment.figures)
    return {**assignment.figures, "files": [{"name": file.path.name, "bytes": file.bytes} for file in files]}


def mask_paths(job: Job) -> tuple[Path, ...]:
    """The mask files that the design asks for."""
    return tuple(job.folder / f"layout.{suffix}" for suffix in job.design.mask.formats)


# --- verification of the written file ------------------------------------------------------------------------------


def _drc(job: Job) -> dict[str, Any]:
    reports = [drc.check(path, job.design, workers=job.workers, progress=job.progress) for path in mask_paths(job)]
    drc.save(reports, job.folder, mask.top_name(job.design.name))
    first = reports[0]
    worst = {rule: max(report.violations[rule] for report in reports) for rule in first.violations}
    # Legal but unlike pillars in two formats would pass every other rule.
    worst["formats_differ"] = len({report.pillars_sha256 for report in reports}) - 1
    return {
        "pillars": first.pillars,
        "violations": worst,
        "min_gap_nm": first.min_gap_nm,
        "engine": first.engine,
        "files": [report.file for report in reports],
    }


def calibration_depths(design: Design, imaging: Imaging) -> tuple[float, ...]:
    """Depths of the PSF stack: the verified ones, and nodes that carry a scene's range by interpolation."""
    if design.scene is None:
        return design.verify.depths_m
    near, far = 1.0 / design.depths_m[0], 1.0 / design.depths_m[-1]
    margin = max(DEPTH_MARGIN * (near - far), SMALLEST_MARGIN * near)
    nodes = optics.depth_nodes(imaging, 1.0 / (near + margin), 1.0 / (far - margin), design.verify.target_error)
    return tuple(sorted({*design.verify.depths_m, *(float(z) for z in nodes)}))


def mask_source(job: Job, path: Path, copy: int = 1) -> optics.Source:
    """What light the pillars of a written file let through; of several lenses, those of one, counted from 1.

    Raises:
        InputError: the file cannot be read, or holds shapes that are no pillars of the lattice: nothing is dropped.
    """
    back = mask.read(path, job.design, progress=job.progress, copy=copy)
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
    standing = mask.biased(back.pillars, -job.design.mask.bias_nm)
    return optics.written_field(standing, open_library(job))


def ideal_source(job: Job) -> optics.Source:
    """What light the target phases would let through, without a mask."""
    lattice = layout.lattice_of(job.design)
    return optics.ideal_field(job.profile, lattice, job.design.device)


def _filter_fwhm_nm(design: Design) -> float | None:
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
    imaging = Imaging.of(job.design)
    if pixel_um is not None:
        imaging = replace(imaging, pixel_um=pixel_um)
    source = ideal_source(job) if path is None else mask_source(job, path, copy)
    x_mm, y_mm = object_mm
    stacks = [
        optics.psf(
            source, imaging, (depth,), tangent=(1e-3 * x_mm / depth, 1e-3 * y_mm / depth),
            window_px=window_px, target_error=target_error, filter_fwhm_nm=_filter_fwhm_nm(job.design),
            progress=job.progress,
        )
        for depth in depths_m
    ]  # fmt: skip
    return optics.concatenate(stacks)


def save_psf(job: Job, psf: Psf, mask_path: Path | None, path: Path, copy: int = 1) -> None:
    """Keep a PSF pair with the fingerprint of the mask's lens (None for target phases) and the design behind it."""
    design = job.design
    source = design.phase if mask_path is None else [file_sha256(mask_path), file_sha256(library_path(job)), copy]
    asked: list[Any] = [psf.depth_m, psf.centre_um, psf.pixel_um, psf.psf.shape, psf.sensor_distance_um]
    if design.optics is not None:
        asked.append(design.optics)
    optics.save(psf, path, inputs_sha256=fingerprint(source, design.device, design.sensor, asked))


def _depth_interpolation_error(written: Psf, shown: np.ndarray) -> float | None:
    """PSFs at the shown depths interpolated from the others, against the computed ones."""
    if shown.all():
        return None
    interpolated = optics.at_depths(optics.without_depths(written, shown), written.depth_m[shown])
    return optics.relative_l2(interpolated, written.psf[:, shown])


def _field_interpolation_error(
    written: Psf, point_spread_of: Callable[..., Psf], source: optics.Source
) -> float | None:
    """Interpolated PSFs in the middle of an outermost cell of field points against computed ones."""
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


def _psf(job: Job) -> dict[str, Any]:
    design, verify = job.design, job.design.verify
    imaging = Imaging.of(design)
    point_spread_of = partial(
        optics.psf,
        imaging=imaging,
        window_px=verify.window_px,
        target_error=verify.target_error,
        filter_fwhm_nm=_filter_fwhm_nm(design),
        progress=job.progress,
    )
    source = mask_source(job, mask_paths(job)[-1])
    written = point_spread_of(
        source,
        depths_m=calibration_depths(design, imaging),
        field_tangents=optics.field_tangents(design, imaging),
    )
    save_psf(job, written, mask_paths(job)[-1], job.folder / "psf.h5")
    ideal = point_spread_of(ideal_source(job), depths_m=verify.depths_m)
    save_psf(job, ideal, None, job.folder / "ideal_psf.h5")
    shown = np.isin(written.depth_m, verify.depths_m)
    return {
        **{name: value[shown] for name, value in psf_figures(written).items()},
        **{f"ideal_{name}": value for name, value in psf_figures(ideal).items() if name != "depth_m"},
        "depth_interpolation_error": _depth_interpolation_error(written, shown),
        "field_interpolation_error": _field_interpolation_error(written, point_spread_of, source),
        "depths": written.depth_m.size,
        **written.details,
    }


# --- camera and decoder ----------------------------------------------------------------------------------------


def expose(
    scene: Scene, psf_path: Path, path: Path, *, seed: int | None = None, progress: Progress = silent
) -> RawFrame:
    """Photograph a scene through a stored PSF pair and keep the raw frame."""
    frame = camera.capture(scene, optics.load(psf_path), seed=seed, progress=progress)
    camera.save(frame, path, inputs_sha256=fingerprint(scene, seed, file_sha256(psf_path)))
    return frame


def restore(raw_path: Path, psf_path: Path, path: Path, *, progress: Progress = silent) -> Image4D:
    """Decode a stored raw frame, ours or a camera's, by a stored PSF pair and keep the 4D image."""
    calibration = optics.load(psf_path)
    image = decode.decode(camera.load_frame(raw_path, calibration), calibration, progress=progress)
    decode.save(image, path, inputs_sha256=fingerprint(file_sha256(raw_path), file_sha256(psf_path)))
    return image


def calibrate(frames: Sequence[Path], depths_path: Path, psf_path: Path, path: Path) -> decode.CameraFit:
    """Calibration of a camera from photographs of a point at the depths of a table."""
    predicted = optics.load(psf_path)
    depths_m = decode.read_depths(depths_path, frames)
    calibrated, fit = decode.calibrate([camera.load_frame(f, predicted) for f in frames], depths_m, predicted)
    optics.save(calibrated, path, inputs_sha256=fingerprint(file_sha256(psf_path), *map(file_sha256, frames)))
    return fit


def _capture(job: Job) -> dict[str, Any]:
    assert job.design.scene is not None  # Without one the step has no point.
    frame = expose(job.design.scene, job.folder / "psf.h5", job.folder / "raw.h5", progress=job.progress)
    return {"shape": frame.frame.shape, "photons": float(frame.frame.sum())}


def _decode(job: Job) -> dict[str, Any]:
    folder = job.folder
    image = restore(folder / "raw.h5", folder / "psf.h5", folder / "decoded.h5", progress=job.progress)
    return {"nmae": image.nmae, "segments": image.segments, **image.details}


def _report(job: Job) -> dict[str, Any]:
    from metafab import report  # With all of matplotlib: only when a page is drawn.

    return {"file": report.write(job.folder, progress=job.progress).name}


# --- the order of things, and what they add up to -------------------------------------------------------------------


def _in_folder(*names: str) -> Callable[[Job], tuple[Path, ...]]:
    return lambda job: tuple(job.folder / name for name in names)


def _nothing_to_decode(design: Design) -> str | None:
    """A decoder needs two images of a scene side by side."""
    if design.scene is None:
        return "the design has no scene to photograph"
    if design.split_angle_deg == 0.0:
        return "the design does not split polarisations, so there is no pair of images to decode"
    return None


def _report_files(job: Job) -> tuple[Path, ...]:
    return (job.folder / "report.html", *sorted((job.folder / "figures").glob("*.png")))


STEPS = (
    Step(
        "library", ("spec", "materials", "cell", "library"), (),
        lambda d: (d.unit_cell, d.library if d.library.suffix == ".h5" else None),
        lambda job: (library_path(job),), _library,
    ),
    Step(
        "phase", ("spec", "phase"), (),
        lambda d: (d.phase, d.device, d.sensor, d.unit_cell.illumination, d.verify, d.numerics),
        _in_folder("phase.h5"), _phase,
    ),
    Step(
        "study", ("spec", "phase"), ("phase",),
        lambda d: (*_study_inputs(d), d.numerics), _in_folder("phase_study.h5"), _study,
    ),
    Step(
        "layout", ("layout", "mask"), ("library", "phase"),
        lambda d: (d.name, d.rules, d.mask, d.device, d.numerics),
        lambda job: (*mask_paths(job), *_in_folder("layout.lyp", "layout.json")(job)), write_layout,
    ),
    Step(
        "drc", ("mask", "drc"), ("layout",),
        lambda d: (d.rules, d.mask, d.device), _in_folder("drc.json", "drc.lyrdb"), _drc,
    ),
    Step(
        "psf", ("mask", "optics"), ("library", "phase", "layout"),
        lambda d: (d.sensor, d.verify, d.scene and d.scene.field_px, d.depths_m, d.optics),
        _in_folder("psf.h5", "ideal_psf.h5"), _psf,
    ),
    Step(
        "capture", ("optics", "camera"), ("psf",),
        lambda d: d.scene, _in_folder("raw.h5"), _capture, _nothing_to_decode,
    ),
    Step(
        "decode", ("optics", "camera", "decode"), ("psf", "capture"),
        lambda d: None, _in_folder("decoded.h5"), _decode, _nothing_to_decode,
    ),
)  # fmt: skip

#: Shows the files of all other steps.
REPORT = Step(
    "report", ("report",), tuple(step.name for step in STEPS), lambda d: d.name, _report_files, _report,
    reads=("coupling.json", "patch.h5"),
)  # fmt: skip


def preflight(design: Design) -> None:
    """Everything that the design alone can tell about whether its steps will work, before the first of them.

    Raises:
        InputError: all that was found.
    """
    faults: list[Fault] = []
    for look in (Imaging.of, layout.lattice_of, layout.field_sites, mask.lens_copies):
        try:
            look(design)
        except InputError as error:
            faults += error.faults
    focal_m = 1e-3 * design.device.focal_length_mm
    depths = {f"verify.depths_m[{i}]": z for i, z in enumerate(design.verify.depths_m)}
    if design.scene is not None:
        depths |= {f"scene.objects[{i}].depth_m": item.depth_m for i, item in enumerate(design.scene.objects)}
    faults += [
        Fault(name, f"a depth beyond the focal length, {focal_m:g} m", f"{depth:g} m", "nearer objects have no image")
        for name, depth in depths.items()
        if depth <= focal_m
    ]
    if not faults and design.scene is not None and design.split_angle_deg > 0.0:
        imaging = Imaging.of(design)
        apart_px = 2.0 * abs(imaging.image_point_um(0, (0.0, 0.0))[0]) / imaging.pixel_um
        if design.scene.field_px[1] >= apart_px:
            faults.append(
                Fault(
                    "scene.field_px",
                    f"fewer columns than the images are apart, {apart_px:.0f}",
                    f"{design.scene.field_px[1]} columns",
                    "narrow the field, or split by a larger angle",
                )
            )
    if faults:
        raise InputError(design.name, faults)


def recorded_coupling(job: Job) -> dict[str, Any]:
    """What ``metafab coupling`` found on a mask of this run, {} if nothing."""
    found = fullwave.load_coupling(job.folder / "coupling.json")
    if found is None or found.mask_sha256 not in {file_sha256(path) for path in mask_paths(job)}:
        return {}
    return {
        "coupling_error": found.coupling_error,
        "efficiency_ratio": found.efficiency_ratio,
        "rows": len(found.rows),
        "solvers": sorted({row.solver for row in found.rows}),
    }


def error_budget(figures: dict[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """The measured contributions to the error of the whole, in the order of the pipeline.

    Args:
        figures: each step's part of the summary, and ``coupling``, where it was measured.

    Returns:
        One row a source: ``source``, ``value`` (None where this run did not measure it), ``unit``, ``how``.
    """
    solved, written, light, decoded = (figures[name] for name in ("library", "layout", "psf", "decode"))
    return [
        _row("solver and library", solved.get("max_error"), "complex t", "largest error of any size: certificate of "
             "the truncation plus interpolation, checked at held-out sizes"),
        _row("size snapping and finite library", written.get("phase_rms_error_rad"), "rad rms",
             "phase of the chosen size against the target, over all pillars"),
        _row("index of the pillar", solved.get("index_phase_error_rad"), "rad rms",
             "phases solved again with the index raised by its standard uncertainty, common phase taken out"),
        _row("local-period approximation", figures.get("coupling", {}).get("coupling_error"), "relative L2",
             "field behind rows of one local period, full-wave, against the stitched library; `metafab coupling`"),
        _row("pupil reduction and sampling", max(light["error"]), "relative L2", "PSF with blocks of half the size"),
        _row("depth interpolation", light["depth_interpolation_error"], "relative L2",
             "PSFs computed at the verified depths against those interpolated from the other nodes"),
        _row("field interpolation", light["field_interpolation_error"], "relative L2",
             "PSF computed in the middle of an outermost cell of field points against the interpolated one"),
        _row("decoder", decoded.get("nmae"), "mean |dz|/z", "decoded against true depth of the simulated scene"),
    ]  # fmt: skip


def _row(source: str, value: float | None, unit: str, how: str) -> dict[str, Any]:
    return {"source": source, "value": value, "unit": unit, "how": how}
