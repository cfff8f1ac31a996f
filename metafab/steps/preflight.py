"""What a design alone tells about whether its steps will work, and what they will make."""

from __future__ import annotations

from typing import Any

from metafab.core.errors import Fault, InputError
from metafab.run import Job, Step
from metafab.spec import Design


def preflight(design: Design) -> None:
    """Everything that the design alone can tell about whether its steps will work, before the first of them.

    Raises:
        InputError: all that was found.
    """
    from metafab import layout, mask
    from metafab.optics import Imaging

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


def _preflight(job: Job) -> dict[str, Any]:
    from metafab import mask

    preflight(job.design)
    return {"announcements": mask.announcement(job.design)}


#: Comes before all others and writes nothing; done again when the design or the code of the rooms that look changed.
PREFLIGHT = Step("preflight", ("spec", "layout", "mask", "optics"), (), lambda d: d, lambda job: (), _preflight)
