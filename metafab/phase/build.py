"""A design's phase terms, in order, as one profile; helices optimised as asked, and what that gained."""

from __future__ import annotations

import math
from typing import TypedDict

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray, image_distance_mm
from metafab.core.errors import Fault, InputError
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.pictures import read_grey
from metafab.information.twin_images import Texture
from metafab.phase.optimise.blind import BlindInformation, optimise_blind
from metafab.phase.optimise.peak import PeakDesign, optimise_peak, spiral_field
from metafab.phase.optimise.rotation import main_lobe, ring_rotation, rotation_deg_per_dioptre
from metafab.phase.optimise.side_lobes import limit_side_lobes
from metafab.phase.pupil import Pupil, phasor, rim_defocus_rad
from metafab.phase.terms.carriers import AxiconPhase, GratingPhase, LensPhase, SplitLensPhase
from metafab.phase.terms.helices import DoubleHelixPhase, SpiralZonesPhase, VortexPhase
from metafab.phase.terms.hologram import design_hologram, widest_picture_um
from metafab.phase.terms.profile import PhaseProfile, Term
from metafab.phase.terms.sampled import SampledPhase, load_array
from metafab.phase.terms.zernike import ZernikePhase
from metafab.spec import terms as spec
from metafab.spec.design import Design

#: Depths at which the rotation is measured; between neighbours the lobe turns by less than half a turn.
_ROTATION_DEPTHS = 49
#: Depths and pupil samples of the search for information.
_BLIND_DEPTHS = 10
_BLIND_SAMPLES = 64
#: Pupil samples of a helix with limited side lobes.
_LIMITED_SAMPLES = 64


def profile_of(design: Design, *, progress: Progress = silent) -> PhaseProfile:
    """The target phase that a design declares.

    Args:
        design: its phase terms add up; ``spiral_zones`` is optimised as its ``optimise`` asks, for the design's
            aperture and over one full turn of the lobe.
        progress: called while optimising.

    Returns:
        The profile. Its figures, for a design with spiral zones: ``peak_gain`` and ``worst_gain`` (mean and smallest
        peak of the main lobe over the full turn against Eq. 2; 1 where nothing is optimised), ``peak_mean`` (Strehl
        ratio), ``target_reached``, ``target_bound`` and ``bound_fraction`` (mean or, for "worst_peak", smallest peak
        at the points aimed at, what no mask can exceed there, and their ratio), ``blind_information_gain`` (over
        Eq. 2, where that was maximised), ``side_lobe`` and ``side_lobe_without_limit`` (over the main lobe, where
        they are limited), ``rotation_deg`` (turn of PSF_x's main lobe from the nearest to the farthest
        depth of ``[verify]``, positive counter-clockwise, by the paraxial pupil), ``rotation_deg_per_dioptre`` and
        its theoretical value: that of the plain spiral's rings where nothing is optimised, else the law that the
        optimised lobe is steered by. Without spiral zones there are none.

    Raises:
        InputError: a user's array or picture cannot be used, or more than one term has spiral zones for one
            polarisation.
    """
    _one_helix(design)
    terms: list[Term] = []
    figures: dict[str, float] = {}
    for term in design.phase:
        if isinstance(term, spec.SpiralZones):
            helix, gained = _helix(design, term, progress)
            terms.append(helix)
            figures.update(gained)
        elif isinstance(term, spec.Picture):
            painting, painted = _hologram(design, term, progress)
            terms.append(painting)
            figures.update(painted)
        else:
            terms.append(_plain_term(design, term))
    return PhaseProfile(tuple(terms), figures)


def _one_helix(design: Design) -> None:
    acting = [term.polarisation for term in design.phase if isinstance(term, spec.SpiralZones)]
    if len(acting) > 1 and (None in acting or len(set(acting)) < len(acting)):
        raise InputError.single(
            design.name, "phase", "at most one `spiral_zones` term for each polarisation", f"{len(acting)} terms"
        )


def _plain_term(design: Design, term: spec.PhaseTerm) -> Term:
    """A term that needs no optimiser."""
    wavelength_um, radius_um = design.wavelength_um, 0.5 * design.device.aperture_um
    only = term.polarisation
    if isinstance(term, spec.SplitLens):
        image_um, object_um = _conjugates_um(design, term.object_depth_m)
        return SplitLensPhase(wavelength_um, image_um, term.angle_deg, object_um, only)
    if isinstance(term, spec.Lens):
        return LensPhase(wavelength_um, *_conjugates_um(design, term.object_depth_m), only)
    if isinstance(term, spec.Vortex):
        return VortexPhase(term.charge, only)
    if isinstance(term, spec.Grating):
        return GratingPhase(wavelength_um, term.angle_deg, term.azimuth_deg, only)
    if isinstance(term, spec.Axicon):
        return AxiconPhase(wavelength_um, term.angle_deg, only)
    if isinstance(term, spec.DoubleHelix):
        return DoubleHelixPhase(radius_um, term.waist, term.modes, only)
    if isinstance(term, spec.Zernike):
        return ZernikePhase(term.degree, term.order, term.amplitude_rad, radius_um, only)
    if isinstance(term, spec.UserArray):
        reach_um = radius_um  # of a square aperture, the half side
        return load_array(term.file, term.pitch_um, term.dataset, reach_um, only)
    raise TypeError(f"`term`: expected a phase term of the design file, got {type(term).__name__}")


def _conjugates_um(design: Design, object_depth_m: float | None) -> tuple[float, float]:
    """Image and object distance of a lens with the design's focal length."""
    depth_m = math.inf if object_depth_m is None else object_depth_m
    try:
        return 1e3 * image_distance_mm(design.device.focal_length_mm, depth_m), 1e6 * depth_m
    except ValueError as error:
        expected = f"a depth beyond the focal length of {design.device.focal_length_mm} mm"
        raise InputError.single(design.name, "phase.object_depth_m", expected, f"{depth_m} m") from error


def _helix(design: Design, term: spec.SpiralZones, progress: Progress) -> tuple[Term, dict[str, float]]:
    radius_um = 0.5 * design.device.aperture_um
    pupil = Pupil(shape=design.device.aperture_shape)
    plain = SpiralZonesPhase(term.zones, term.exponent, radius_um, term.polarisation)
    if term.optimise == "none":
        return plain, {"peak_gain": 1.0, **_rotation(design, term, plain, pupil)}
    best = optimise_peak(
        term.zones,
        term.exponent,
        pupil=pupil,
        goal="worst" if term.optimise == "worst_peak" else "mean",
        iterations=max(1, round(design.numerics.iterations)),
        seed=design.numerics.seed,
        progress=progress,
    )
    if term.optimise == "blind_information":
        return _blind_helix(design, term, best, progress)
    if term.side_lobe_limit is not None:
        return _limited_helix(design, term, best, progress)
    helix = best.term(radius_um, term.polarisation)
    figures = {
        "peak_gain": best.peak_gain,
        "worst_gain": best.worst_gain,
        "peak_mean": float(best.lobe.peak.mean()),
        "target_reached": best.reached,
        "target_bound": best.bound.dual,
        "bound_fraction": best.bound_fraction,
    }
    return helix, figures | _rotation(design, term, helix, pupil)


def _limited_helix(
    design: Design, term: spec.SpiralZones, start: PeakDesign, progress: Progress
) -> tuple[Term, dict[str, float]]:
    """The brightest helix whose side lobes keep the limit."""
    radius_um = 0.5 * design.device.aperture_um
    limit, pupil = float(term.side_lobe_limit or 0.0), Pupil(_LIMITED_SAMPLES, design.device.aperture_shape)
    try:
        best = limit_side_lobes(
            start, limit, over=term.side_lobe_over, pupil=pupil, exponent=term.exponent, progress=progress
        )
    except ValueError as error:
        raise InputError.single(
            design.name, "phase.side_lobe_limit", "a limit that some mask keeps", f"{limit:g}", str(error)
        ) from error
    helix = best.term(radius_um, term.polarisation)
    figures = {
        "peak_gain": best.peak_gain,
        "worst_gain": best.worst_gain,
        "peak_mean": float(best.lobe.peak.mean()),
        "side_lobe": best.held,
        "side_lobe_without_limit": best.held_at_start,
    }
    return helix, figures | _rotation(design, term, helix, pupil)


def _blind_helix(
    design: Design, term: spec.SpiralZones, start: PeakDesign, progress: Progress
) -> tuple[Term, dict[str, float]]:
    """The helix that tells most over the depths of ``[verify]`` and the scene, begun at the brightest one."""
    radius_um = 0.5 * design.device.aperture_um
    assert design.scene is not None  # The spec asks for one.
    vergence = np.linspace(1.0 / design.depths_m[0], 1.0 / design.depths_m[-1], _BLIND_DEPTHS)
    with np.errstate(divide="ignore"):  # The farthest depth may be infinite.
        defocus = rim_defocus_rad(1.0 / vergence, design.sensor.focus_depth_m, radius_um, design.wavelength_um)
    scene = design.scene
    texture = Texture(electrons=scene.photons_per_pixel, read_noise_e=scene.read_noise_e)
    pupil = Pupil(_BLIND_SAMPLES, design.device.aperture_shape)
    problem = BlindInformation(pupil, defocus, texture)
    best = optimise_blind(problem, pupil_field(start.term(1.0), pupil, 1.0), iterations=20, progress=progress)
    plain_information = problem.of_field(spiral_field(pupil, term.zones, term.exponent))
    helix = best.term(radius_um, term.polarisation)
    lobe = main_lobe(pupil, phasor(best.phase_rad), start.defocus_rad, 2.0 * term.zones + 6.0)
    figures = {
        "peak_gain": float(lobe.peak.mean() / start.plain.peak.mean()),
        "worst_gain": float(lobe.peak.min() / start.plain.peak.min()),
        "peak_mean": float(lobe.peak.mean()),
        "blind_information_gain": float(best.information.mean() / plain_information.mean()),
    }
    return helix, figures | _rotation(design, term, helix, pupil)


def _rotation(design: Design, term: spec.SpiralZones, helix: Term, pupil: Pupil) -> dict[str, float]:
    """How far and how fast the lobe turns over the design's depths."""
    radius_um = 0.5 * design.device.aperture_um
    nearest_m, farthest_m = design.verify.depths_m[0], design.verify.depths_m[-1]
    theory = rotation_deg_per_dioptre(term.zones, radius_um, design.wavelength_um)
    if term.optimise == "none" and term.zones > 1:
        theory *= -term.zones * ring_rotation(term.zones, term.exponent)[1]
    figures = {"rotation_deg_per_dioptre_theory": theory}
    if nearest_m == farthest_m or term.zones == 1:
        return {"rotation_deg": 0.0, **figures}
    vergence = np.linspace(1.0 / nearest_m, 1.0 / farthest_m, _ROTATION_DEPTHS)
    with np.errstate(divide="ignore"):  # The farthest depth may be infinite.
        defocus = rim_defocus_rad(1.0 / vergence, design.sensor.focus_depth_m, radius_um, design.wavelength_um)
    lobe = main_lobe(pupil, pupil_field(helix, pupil, radius_um), defocus, 2.0 * term.zones + 6.0)
    return {
        "rotation_deg": float(lobe.phi_deg[-1] - lobe.phi_deg[0]),
        "rotation_deg_per_dioptre": float(np.polyfit(vergence, lobe.phi_deg, 1)[0]),
        **figures,
    }


def require_paintable(design: Design) -> None:
    """Refuse pictures that cannot be read, are dark, or reach farther than the lattice can send light.

    Raises:
        InputError: all that was found.
    """
    faults = []
    for number, term in enumerate(design.phase):
        if isinstance(term, spec.Picture):
            name = f"phase[{number}]"
            try:
                rows, columns = _picture(term).shape
            except InputError as error:
                faults += [Fault(f"{name}.file", f.expected, f.got, f.remedy) for f in error.faults]
                continue
            most_um = widest_picture_um((rows, columns), **_image_plane(design))
            if term.width_um > most_um:
                expected = f"at most {most_um:.6g} um (wavelength times distance over period, along x and y)"
                faults.append(Fault(f"{name}.width_um", expected, f"{term.width_um:g} um", "narrow the picture"))
    if faults:
        raise InputError(design.name, faults)


def _hologram(design: Design, term: spec.Picture, progress: Progress) -> tuple[Term, dict[str, float]]:
    """The hologram of a picture, sampled at the lattice's sites."""
    require_paintable(design)
    plane = _image_plane(design)
    pitch_um = plane["pitch_um"]
    count = int(design.device.aperture_um / pitch_um + 1e-9)
    found = design_hologram(
        _picture(term),
        term.width_um,
        inside=Pupil(count, design.device.aperture_shape).inside,
        **plane,
        progress=progress,
    )
    figures = {"hologram_efficiency": found.efficiency, "hologram_correlation": found.correlation}
    return SampledPhase(np.stack([found.field, found.field]), pitch_um, term.polarisation), figures


def _picture(term: spec.Picture) -> FloatArray:
    picture = read_grey(term.file)
    if not np.isfinite(picture).all() or picture.min() < 0.0 or picture.max() == 0.0:
        least, most = float(picture.min()), float(picture.max())
        got = f"{least:g} to {most:g}" if math.isfinite(least + most) else "NaN or infinity"
        raise InputError.single(str(term.file), "values", "finite, none below zero, and some above", got)
    return picture


class _ImagePlane(TypedDict):
    """Where a picture is painted, and from sites how far apart."""

    pitch_um: float
    wavelength_um: float
    distance_um: float


def _image_plane(design: Design) -> _ImagePlane:
    return {
        "pitch_um": 1e-3 * min(design.unit_cell.cell.period_nm),
        "wavelength_um": design.wavelength_um,
        "distance_um": _conjugates_um(design, design.sensor.focus_depth_m)[0],
    }


def pupil_field(term: Term, pupil: Pupil, radius_um: float) -> ComplexArray:
    """exp(i psi) of a term for x polarisation at the pupil's samples, shape (n,)."""
    positions_um: FloatArray = radius_um * pupil.axis
    return phasor(term(positions_um, positions_um, "x")[pupil.inside])
