"""Phase terms of a design file as formulas of (x, y)."""

from __future__ import annotations

import math

from metafab.core.conventions import image_distance_mm
from metafab.core.errors import InputError
from metafab.phase.terms.carriers import AxiconPhase, GratingPhase, LensPhase, SplitLensPhase
from metafab.phase.terms.helices import DoubleHelixPhase, VortexPhase
from metafab.phase.terms.profile import SumTerm, Term
from metafab.phase.terms.sampled import load_array
from metafab.phase.terms.zernike import RadialPhase, ZernikePhase, zernike_number
from metafab.spec import terms as spec
from metafab.spec.design import Design


def plain_term(design: Design, term: spec.PhaseTerm) -> Term:
    """Return the formula of a term that needs no optimiser; InputError for an unusable array."""
    wavelength_um, radius_um = design.wavelength_um, 0.5 * design.device.aperture_um
    only = term.polarisation
    if isinstance(term, spec.SplitLens):
        image_um, object_um = conjugates_um(design, term.object_depth_m)
        return SplitLensPhase(
            wavelength_um=wavelength_um,
            image_distance_um=image_um,
            angle_deg=term.angle_deg,
            object_distance_um=object_um,
            polarisation=only,
        )
    if isinstance(term, spec.Lens):
        image_um, object_um = conjugates_um(design, term.object_depth_m)
        return LensPhase(
            wavelength_um=wavelength_um, image_distance_um=image_um, object_distance_um=object_um, polarisation=only
        )
    if isinstance(term, spec.Vortex):
        return VortexPhase(charge=term.charge, polarisation=only)
    if isinstance(term, spec.Grating):
        return GratingPhase(
            wavelength_um=wavelength_um, angle_deg=term.angle_deg, azimuth_deg=term.azimuth_deg, polarisation=only
        )
    if isinstance(term, spec.Axicon):
        return AxiconPhase(wavelength_um=wavelength_um, angle_deg=term.angle_deg, polarisation=only)
    if isinstance(term, spec.DoubleHelix):
        return DoubleHelixPhase(radius_um=radius_um, waist=term.waist, modes=term.modes, polarisation=only)
    if isinstance(term, spec.Zernike):
        return ZernikePhase(
            degree=term.degree,
            order=term.order,
            amplitude_rad=term.amplitude_rad,
            radius_um=radius_um,
            polarisation=only,
        )
    if isinstance(term, spec.Zernikes):
        numbered = enumerate(term.coefficients_rad, start=1)
        found = [(zernike_number(number, term.convention), value) for number, value in numbered if value]
        return SumTerm(
            tuple(
                ZernikePhase(degree=n, order=m, amplitude_rad=norm * value, radius_um=radius_um, polarisation=only)
                for (n, m, norm), value in found
            )
            or (ZernikePhase(degree=0, order=0, amplitude_rad=0.0, radius_um=radius_um),)
        )
    if isinstance(term, spec.Radial):
        if term.convention == "binary2":
            return RadialPhase(
                coefficients_rad=term.coefficients, radius_um=term.norm_radius_um or radius_um, polarisation=only
            )
        per_mm = 2e3 * math.pi / wavelength_um
        return RadialPhase(
            coefficients_rad=tuple(per_mm * value for value in term.coefficients), radius_um=1e3, polarisation=only
        )
    if isinstance(term, spec.UserArray):
        # The radius of a square aperture is its half side.
        return load_array(term.file, term.pitch_um, term.dataset, radius_um, only)
    raise TypeError(f"`term`: expected a phase term of the design file, got {type(term).__name__}")


def conjugates_um(design: Design, object_depth_m: float | None) -> tuple[float, float]:
    """Image and object distance of a lens with the design's focal length; InputError for an object within it."""
    depth_m = math.inf if object_depth_m is None else object_depth_m
    try:
        return 1e3 * image_distance_mm(design.device.focal_length_mm, depth_m), 1e6 * depth_m
    except ValueError as error:
        expected = f"a depth beyond the focal length of {design.device.focal_length_mm} mm"
        raise InputError.single(design.name, "phase.object_depth_m", expected, f"{depth_m} m") from error
