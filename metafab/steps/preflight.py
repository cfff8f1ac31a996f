"""Checks of the design alone, before any step runs."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from metafab.core.errors import Fault, InputError
from metafab.spec import Design, Scene
from metafab.steps.job import Job, Step, light_tangent

#: Share of the aperture that may be too steep without a warning: the rim of a lens that just fits, the centre of a
#: vortex.
_STEEP_SHARE = 0.002


@dataclass(frozen=True)
class PreflightFigures:
    """Outcome of the checks."""

    announcements: tuple[str, ...]  #: Sentences for the user about long work and large files.


def preflight(design: Design, *, turned: bool = False) -> None:
    """Check whether the steps of a design can work, from the design alone.

    ``turned`` pillars are drawn with rounded vertices. InputError with all faults that were found.
    """
    from metafab import layout, mask
    from metafab.mask.drawing.stamps import require_invertible
    from metafab.optics import Imaging
    from metafab.phase.picture import require_paintable

    faults: list[Fault] = []
    of_lattice = (
        (layout.Aperture.of, layout.field_sites, mask.shapes_beside, require_invertible)
        if design.has_mask
        else (layout.lattice_of,)
    )
    for check in (Imaging.of, *of_lattice, require_paintable):
        try:
            check(design)
        except InputError as error:
            faults += error.faults
    faults += _depths_without_image(design)
    for light in design.light:
        try:
            light_tangent(design, light)
        except InputError as error:
            faults += error.faults
    if design.has_mask:
        faults += _unreachable_rules(design)
        if not turned:
            faults += _sizes_off_the_unit(design)
        faults += _proximity_classes(design)
        faults += _pillars_unsolved_at_angles(design)
    if not faults:
        faults += _coarse_pixels(design)
    if not faults and design.scene is not None:
        faults += _objects_outside_view(design, design.scene)
        faults += _overlapping_images(design, design.scene)
    if faults:
        raise InputError(design.name, faults)


def _depths_without_image(design: Design) -> list[Fault]:
    """Depths within the focal length."""
    focal_m = 1e-3 * design.device.focal_length_mm
    depths = {f"verify.depths_m[{i}]": z for i, z in enumerate(design.verify.depths_m)}
    if design.scene is not None:
        depths |= {f"scene.objects[{i}].depth_m": item.depth_m for i, item in enumerate(design.scene.objects)}
    expected, remedy = f"a depth beyond the focal length, {focal_m:g} m", "nearer objects have no image"
    return [Fault(name, expected, f"{depth:g} m", remedy) for name, depth in depths.items() if depth <= focal_m]


def _coarse_pixels(design: Design) -> list[Fault]:
    """Pixels too coarse for the irradiance of the aperture, for the field and for each light."""
    from metafab.optics import Imaging, field_tangents
    from metafab.optics.numerics import require_fine_pixels

    faults = []
    for light in design.light or (None,):
        lit = design if light is None else design.at_light(light)
        imaging, directions = Imaging.of(lit), [(0.0, 0.0)]
        if light is not None and light.angles_deg:
            directions = [light_tangent(lit, light)]
        elif (grid := field_tangents(lit, imaging)) is not None:
            directions = [(float(x), float(y)) for y in grid[1] for x in grid[0]]
        try:
            require_fine_pixels(imaging, directions)
        except InputError as error:
            faults += [replace(fault, field="sensor.pixel_um") for fault in error.faults]
    return faults[:1]


def _overlapping_images(design: Design, scene: Scene) -> list[Fault]:
    """A field so wide that the images of both polarisations overlap."""
    from metafab.optics import Imaging

    imaging = Imaging.of(design)
    apart_px = 2.0 * abs(imaging.image_point_um(0, (0.0, 0.0))[0]) / imaging.pixel_um
    if design.split_angle_deg == 0.0 or scene.field_px[1] < apart_px:
        return []
    expected = f"fewer columns than the {apart_px:.3g} pixels of {imaging.pixel_um:g} um between the images"
    remedy = "narrow the field, make `sensor.pixel_um` smaller, or split by a larger angle"
    return [Fault("scene.field_px", expected, f"{scene.field_px[1]} columns", remedy)]


def _unreachable_rules(design: Design) -> list[Fault]:
    """Rules that no size of the library keeps."""
    sweep, cell = design.unit_cell.sweep, design.unit_cell.cell
    faults = []
    for axis, (name, (low, high)) in enumerate((("width", sweep.width_nm), ("length", sweep.length_nm))):
        smallest_nm = max(low, design.min_side_nm)
        if design.min_side_nm > high:
            faults += _too_large_sides(design, name, high)
            smallest_nm = low
        apart_nm = cell.period_nm[axis] - smallest_nm
        if not cell.is_hexagonal and design.min_spacing_nm > apart_nm:
            most = _with_bias(apart_nm, -design.mask.bias_nm)
            expected = f"at most {most}, the gap of two of the smallest pillars side by side along {'xy'[axis]}"
            got = f"{design.rules.min_gap_nm:g} nm"
            faults.append(Fault("rules.min_gap_nm", expected, got, "sweep smaller sizes, or widen the period"))
    return faults


def _too_large_sides(design: Design, name: str, largest_nm: float) -> list[Fault]:
    """The rules that ask for more than the largest width or length (``name``) of the library."""
    cell, rules, bias_nm = design.unit_cell.cell, design.rules, design.mask.bias_nm
    if cell.shape == "ring":
        keys, expected = "rules.min_feature_nm, rules.min_gap_nm", f"at most the largest {name}, {largest_nm:g} nm"
        return [Fault(keys, expected, f"{design.min_side_nm:g} nm", "sweep larger sizes")]
    faults, ratio = [], rules.max_aspect_ratio
    if ratio is not None and cell.height_nm > ratio * largest_nm:
        least = math.ceil(1e3 * cell.height_nm / largest_nm) / 1e3
        expected = f"at least {least:g}, the height over the largest {name} of the library, {largest_nm:g} nm"
        faults.append(Fault("rules.max_aspect_ratio", expected, f"{ratio:g}", "allow more, or sweep larger sizes"))
    if rules.min_feature_nm - bias_nm > largest_nm:
        expected = f"at most {_with_bias(largest_nm, bias_nm)}, the largest {name} of the library"
        faults.append(Fault("rules.min_feature_nm", expected, f"{rules.min_feature_nm:g} nm", "sweep larger sizes"))
    return faults


def _with_bias(pillars_nm: float, change_nm: float) -> str:
    """The limit of a rule for what is drawn, from that of the pillars and what ``mask.bias_nm`` changes it by."""
    bias = f" ({pillars_nm:g} nm without `mask.bias_nm`)" if change_nm else ""
    return f"{pillars_nm + change_nm:g} nm{bias}"


def _sizes_off_the_unit(design: Design) -> list[Fault]:
    """A database unit on which the edges of the library's sizes do not lie."""
    from metafab.library.fit.size_grid import SizeGrid
    from metafab.library.use.lookup import fault_of_unit

    grid = SizeGrid.of(design.unit_cell)
    fault = fault_of_unit(np.concatenate([grid.width_nm, grid.length_nm]), design.mask.database_unit_nm)
    return [] if fault is None else [fault]


def _proximity_classes(design: Design) -> list[Fault]:
    """Dose classes by proximity, which only the exposure of a written mask can give."""
    if design.mask.dose is None or design.mask.dose.by != "proximity":
        return []
    remedy = "leave out [mask.dose], then run `metafab expose LAYOUT --design DESIGN.toml --correct -o DIR`"
    return [Fault("mask.dose.by", "'size' or 'density'", "'proximity'", remedy)]


def _pillars_unsolved_at_angles(design: Design) -> list[Fault]:
    """``[optics] oblique`` with pillars that are not solved under oblique light."""
    from metafab.library.use.oblique import is_solved_at_angles
    from metafab.steps.optics.sources import unsolved_angles

    if design.optics is None or not design.optics.oblique or is_solved_at_angles(design.unit_cell):
        return []
    return [unsolved_angles("others")]


def _objects_outside_view(design: Design, scene: Scene) -> list[Fault]:
    """Objects at rest outside the field of view; directions are tangents."""
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


def too_steep(job: Job) -> list[str]:
    """Return a warning, for each light, if the target phases are steeper than the pillars can follow."""
    from metafab.phase.slopes import undersampled_share

    warnings = []
    for light in job.design.light or (None,):
        design = job.design if light is None else job.at_light(light).design
        share = undersampled_share(design) if design.has_mask else 0.0
        if share > _STEEP_SHARE:
            at = "" if light is None else f"at {light.label}, "
            period = " x ".join(f"{period_nm:g}" for period_nm in dict.fromkeys(design.unit_cell.cell.period_nm))
            warnings.append(
                f"{at}the target phase turns by more than half a turn from pillar to pillar (period {period} nm) in "
                f"{100.0 * share:.3g} % of the aperture: light from there leaves as if the phase had one turn less for "
                "each pillar; make the phase flatter, or take a shorter period"
            )
    return warnings


def _preflight(job: Job) -> PreflightFigures:
    from metafab import mask
    from metafab.cell.open_orders import open_orders
    from metafab.library.axes import incidence

    preflight(job.design)
    lights = [(f"at {x.label}, ", job.at_light(x).design.unit_cell, incidence(x.angles_deg)) for x in job.design.light]
    orders = [
        at + each.sentence()
        for at, cell, angles in lights or [("", job.design.unit_cell, {})]
        if job.design.has_mask
        for each in open_orders(cell, **angles)
    ]
    return PreflightFigures((*orders, *too_steep(job), *mask.announcement(job.design)))


#: Runs before all other steps and writes no file.
PREFLIGHT = Step(
    name="preflight",
    rooms=("spec", "cell", "phase", "layout", "mask", "optics"),
    after=(),
    inputs=lambda design: design,
    outputs=lambda job: (),
    work=_preflight,
    figures=PreflightFigures,
)
