"""What a design alone tells about whether its steps will work, and what they will make."""

from __future__ import annotations

from typing import Any

from metafab.core.errors import Fault, InputError
from metafab.spec import Design, Scene
from metafab.steps.job import Job, Step


def preflight(design: Design) -> None:
    """Everything that the design alone can tell about whether its steps will work, before the first of them.

    Raises:
        InputError: all that was found.
    """
    from metafab import layout, mask
    from metafab.optics import Imaging
    from metafab.phase.build import require_paintable

    faults: list[Fault] = []
    of_mask = (layout.Aperture.of, layout.field_sites, mask.lens_copies) if design.has_mask else (layout.lattice_of,)
    for look in (Imaging.of, *of_mask, require_paintable):
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
    if design.has_mask:
        faults += _rules_that_no_size_keeps(design)
    if not faults and design.scene is not None:
        faults += _objects_out_of_sight(design, design.scene)
    if not faults and design.scene is not None and design.split_angle_deg > 0.0:
        imaging = Imaging.of(design)
        apart_px = 2.0 * abs(imaging.image_point_um(0, (0.0, 0.0))[0]) / imaging.pixel_um
        if design.scene.field_px[1] >= apart_px:
            faults.append(
                Fault(
                    "scene.field_px",
                    f"fewer columns than the images are apart, {apart_px:.3g} pixels of {imaging.pixel_um:g} um",
                    f"{design.scene.field_px[1]} columns",
                    "narrow the field, make `sensor.pixel_um` smaller, or split by a larger angle",
                )
            )
    if faults:
        raise InputError(design.name, faults)


def _rules_that_no_size_keeps(design: Design) -> list[Fault]:
    """Rules that leave the library nothing, found before the library is built."""
    sweep, period_nm = design.unit_cell.sweep, design.unit_cell.cell.period_nm
    faults = []
    for axis, (name, (low, high)) in enumerate((("width", sweep.width_nm), ("length", sweep.length_nm))):
        if design.min_side_nm > high:
            expected = f"at most the largest {name} of the library, {high:g} nm"
            faults.append(Fault("rules.min_feature_nm", expected, f"{design.min_side_nm:g} nm", "sweep larger sizes"))
        apart_nm = period_nm[axis] - max(low, design.min_side_nm)
        if not design.unit_cell.cell.is_hexagonal and design.min_spacing_nm > apart_nm:
            expected = (
                f"at most {apart_nm:g} nm, the gap of two of the smallest pillars side by side along {'xy'[axis]}"
            )
            got = f"{design.min_spacing_nm:g} nm"
            faults.append(Fault("rules.min_gap_nm", expected, got, "sweep smaller sizes, or widen the period"))
    return faults


def _objects_out_of_sight(design: Design, scene: Scene) -> list[Fault]:
    """Objects that stand still and no pixel sees; their directions are tangents."""
    from metafab.optics import Imaging

    imaging = Imaging.of(design)
    half_y, half_x = (0.5 * count * imaging.pixel_um / imaging.sensor_distance_um for count in scene.field_px)
    return [
        Fault(
            f"scene.objects[{number}].centre",
            f"an object that reaches into the field of view, {half_x:.3g} to either side and {half_y:.3g} up and down",
            f"tangents {piece.centre[0]:g} and {piece.centre[1]:g}",
            "move it, or widen `scene.field_px`",
        )
        for number, piece in enumerate(scene.objects)
        if not piece.moves
        and any(
            abs(at) - 0.5 * size > half
            for at, size, half in zip(piece.centre, piece.size, (half_x, half_y), strict=True)
        )
    ]


def _preflight(job: Job) -> dict[str, Any]:
    from metafab import mask

    preflight(job.design)
    return {"announcements": mask.announcement(job.design)}


#: Comes before all others and writes nothing; done again when the design or the code of the rooms that look changed.
PREFLIGHT = Step(
    "preflight", ("spec", "phase", "layout", "mask", "optics"), (), lambda d: d, lambda job: (), _preflight
)
