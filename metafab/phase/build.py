"""A design's phase terms as one profile, with its helices optimised and its holograms designed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import POLARISATIONS, FloatArray, image_distance_mm, wrap_phase
from metafab.core.errors import Fault, InputError
from metafab.core.figures import PhaseFigures
from metafab.core.numeric.phasor import phasor
from metafab.core.parallel.executor import one_blas_thread
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.files import Latest, file_mark
from metafab.core.storage.pictures import read_grey
from metafab.core.storage.tables import applicable
from metafab.information.texture import Texture
from metafab.phase.optimise.blind import BlindDesign, BlindInformation, optimise_blind
from metafab.phase.optimise.peak import PeakDesign, optimise_peak
from metafab.phase.optimise.rotation import helix_half_width, main_lobe, ring_rotation, rotation_deg_per_dioptre
from metafab.phase.optimise.side_lobes import SideLobeDesign, limit_side_lobes
from metafab.phase.pupil import Pupil, pupil_field, rim_defocus_rad
from metafab.phase.terms.carriers import AxiconPhase, GratingPhase, LensPhase, SplitLensPhase
from metafab.phase.terms.helices import DoubleHelixPhase, SpiralZonesPhase, VortexPhase, spiral_field
from metafab.phase.terms.hologram import ImagePlane, design_hologram
from metafab.phase.terms.profile import PhaseProfile, SumTerm, Term
from metafab.phase.terms.sampled import SampledMask, SampledPhase, load_array
from metafab.phase.terms.zernike import RadialPhase, ZernikePhase, zernike_number
from metafab.spec import terms as spec
from metafab.spec.design import Design

#: Depths at which the rotation is measured; between neighbours the lobe turns by less than half a turn.
_ROTATION_DEPTHS = 49
#: Depths of the search for information.
_BLIND_DEPTHS = 10
#: Pupil samples a side of a helix whose samples are free: of largest information, or with limited side lobes.
_SEARCH_SAMPLES = 64
#: Places along a side of the aperture at which the mean slope of a target is taken.
_SLOPE_PLACES = 128
#: Periods over which the slope of a formula is taken, and least number of periods for that of an array. Over four
#: periods a jump by half a turn, as at an outline, adds an eighth of a turn from pillar to pillar, and levels count as
#: the slope that they approximate.
_LOCAL, _WINDOW = 1e-3, 4.0
#: Relative rounding of a phase step of exactly half a turn from pillar to pillar.
_ROUNDING = 1e-6
#: The direction that was found last; each step of a run needs it.
_DIRECTIONS: Latest[tuple[tuple[float, float], tuple[float, float]]] = Latest()


@one_blas_thread()
def profile_of(design: Design, *, progress: Progress = silent) -> PhaseProfile:
    """Build the target phase of a design, the sum of its phase terms, with its key figures.

    ``spiral_zones`` is optimised as its ``optimise`` says, for the aperture of the design and over one full turn of the
    lobe. An unusable array or picture, and two terms with spiral zones for one polarisation, raise InputError.
    """
    helices = [term.polarisation for term in design.phase if isinstance(term, spec.SpiralZones)]
    if len(helices) > 1 and (None in helices or len(set(helices)) < len(helices)):
        expected = "at most one `spiral_zones` term for each polarisation"
        raise InputError.single(design.name, "phase", expected, f"{len(helices)} terms")
    terms: list[Term] = []
    figures = PhaseFigures()
    for spec_term in design.phase:
        if isinstance(spec_term, spec.SpiralZones):
            term, added = _helix(design, spec_term, progress)
        elif isinstance(spec_term, spec.Picture):
            term, added = _hologram(design, spec_term, progress)
        else:
            term, added = _plain_term(design, spec_term), PhaseFigures()
        terms.append(term)
        figures = replace(figures, **applicable(added))
    return PhaseProfile(tuple(terms), figures)


def _plain_term(design: Design, term: spec.PhaseTerm) -> Term:
    """A term that needs no optimiser."""
    wavelength_um, radius_um = design.wavelength_um, 0.5 * design.device.aperture_um
    only = term.polarisation
    if isinstance(term, spec.SplitLens):
        image_um, object_um = _conjugates_um(design, term.object_depth_m)
        return SplitLensPhase(
            wavelength_um=wavelength_um,
            image_distance_um=image_um,
            angle_deg=term.angle_deg,
            object_distance_um=object_um,
            polarisation=only,
        )
    if isinstance(term, spec.Lens):
        image_um, object_um = _conjugates_um(design, term.object_depth_m)
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


def _conjugates_um(design: Design, object_depth_m: float | None) -> tuple[float, float]:
    """Image and object distance of a lens with the design's focal length."""
    depth_m = math.inf if object_depth_m is None else object_depth_m
    try:
        return 1e3 * image_distance_mm(design.device.focal_length_mm, depth_m), 1e6 * depth_m
    except ValueError as error:
        expected = f"a depth beyond the focal length of {design.device.focal_length_mm} mm"
        raise InputError.single(design.name, "phase.object_depth_m", expected, f"{depth_m} m") from error


def _helix(design: Design, term: spec.SpiralZones, progress: Progress) -> tuple[Term, PhaseFigures]:
    """Spiral zones, optimised as the design file says, and their figures."""
    radius_um, shape = 0.5 * design.device.aperture_um, design.device.aperture_shape
    if term.optimise == "none":
        plain = SpiralZonesPhase(
            zones=term.zones, exponent=term.exponent, radius_um=radius_um, polarisation=term.polarisation
        )
        return plain, _with_rotation(PhaseFigures(peak_gain=1.0), design, term, plain, Pupil(shape=shape))
    brightest = optimise_peak(
        term.zones,
        term.exponent,
        pupil=Pupil(shape=shape),
        goal="worst" if term.optimise == "worst_peak" else "mean",
        iterations=max(1, round(design.numerics.iterations)),
        seed=design.numerics.seed,
        progress=progress,
    )
    mask: PeakDesign | SampledMask = brightest
    lobe, plain_lobe, pupil = brightest.lobe, brightest.plain, Pupil(_SEARCH_SAMPLES, shape)
    if term.optimise == "blind_information":
        mask, gain = _informed(design, term, brightest, pupil, progress)
        lobe = main_lobe(pupil, phasor(mask.phase_rad), brightest.defocus_rad, helix_half_width(term.zones))
        further = {"blind_information_gain": gain}
    elif term.side_lobe_limit is not None:
        mask = limited = _limited(design, term, term.side_lobe_limit, brightest, pupil, progress)
        lobe, plain_lobe = limited.lobe, limited.plain
        further = {"side_lobe": limited.limited, "side_lobe_without_limit": limited.limited_at_start}
    else:
        pupil, bound = Pupil(shape=shape), brightest.bound.dual
        further = {"target_reached": brightest.reached, "target_bound": bound}
        further["bound_fraction"] = brightest.bound_fraction
    figures = PhaseFigures(
        peak_gain=lobe.peak_gain(plain_lobe),
        worst_gain=lobe.worst_gain(plain_lobe),
        peak_mean=float(lobe.peak.mean()),
        **further,
    )
    helix = mask.term(radius_um, term.polarisation)
    return helix, _with_rotation(figures, design, term, helix, pupil)


def _limited(
    design: Design, term: spec.SpiralZones, limit: float, start: PeakDesign, pupil: Pupil, progress: Progress
) -> SideLobeDesign:
    """The brightest helix whose side lobes stay below the limit."""
    try:
        return limit_side_lobes(
            start, limit, over=term.side_lobe_over, pupil=pupil, exponent=term.exponent, progress=progress
        )
    except ValueError as error:
        expected = "a limit that some mask keeps"
        raise InputError.single(design.name, "phase.side_lobe_limit", expected, f"{limit:g}", str(error)) from error


def _informed(
    design: Design, term: spec.SpiralZones, start: PeakDesign, pupil: Pupil, progress: Progress
) -> tuple[BlindDesign, float]:
    """The helix with the largest depth information for the scene, and its gain over the plain spiral's."""
    scene = design.scene
    assert scene is not None  # validated with the design
    _, defocus = _vergences(design, design.depths_m, _BLIND_DEPTHS)
    problem = BlindInformation(
        pupil, defocus, Texture(electrons=scene.photons_per_pixel, read_noise_e=scene.read_noise_e)
    )
    best = optimise_blind(problem, pupil_field(start.term(1.0), pupil, 1.0), iterations=20, progress=progress)
    plain = problem.of_field(spiral_field(pupil, term.zones, term.exponent))
    return best, float(best.information.mean() / plain.mean())


def _with_rotation(
    figures: PhaseFigures, design: Design, term: spec.SpiralZones, helix: Term, pupil: Pupil
) -> PhaseFigures:
    """Add the turn of the lobe over the depths of ``[verify]`` to the figures."""
    radius_um = 0.5 * design.device.aperture_um
    theory = rotation_deg_per_dioptre(term.zones, radius_um, design.wavelength_um)
    if term.optimise == "none" and term.zones > 1:
        theory *= -term.zones * ring_rotation(term.zones, term.exponent)[1]
    figures = replace(figures, rotation_deg_per_dioptre_theory=theory)
    if design.verify.depths_m[0] == design.verify.depths_m[-1] or term.zones == 1:
        return replace(figures, rotation_deg=0.0)
    vergence, defocus = _vergences(design, design.verify.depths_m, _ROTATION_DEPTHS)
    lobe = main_lobe(pupil, pupil_field(helix, pupil, radius_um), defocus, helix_half_width(term.zones))
    return replace(
        figures,
        rotation_deg=float(lobe.phi_deg[-1] - lobe.phi_deg[0]),
        rotation_deg_per_dioptre=float(np.polyfit(vergence, lobe.phi_deg, 1)[0]),
    )


def _vergences(design: Design, depths_m: Sequence[float], count: int) -> tuple[FloatArray, FloatArray]:
    """Evenly spaced vergences (1/m) from the first to the last depth, and the rim defocus (rad) at each."""
    vergence = np.linspace(1.0 / depths_m[0], 1.0 / depths_m[-1], count)
    with np.errstate(divide="ignore"):  # The farthest depth may be infinite.
        depth_m = 1.0 / vergence
    radius_um = 0.5 * design.device.aperture_um
    return vergence, rim_defocus_rad(depth_m, design.sensor.focus_depth_m, radius_um, design.wavelength_um)


def mean_direction(design: Design) -> tuple[tuple[float, float], tuple[float, float]]:
    """Direction cosines (x, y) that the mean slope of a design's own phases adds, for x and y polarised light.

    Arrays and Zernike polynomials count; an unusable array raises InputError. Gratings have their own direction;
    lenses, helices and holograms are centred on it. The slope is the mean over the aperture of the wrapped difference
    between neighbouring sites.
    """
    own = tuple(term for term in design.phase if term.is_own)
    if not own:
        return (0.0, 0.0), (0.0, 0.0)
    files = [term.file for term in own if isinstance(term, spec.UserArray) and term.file.is_file()]
    key = (own, design.device, design.wavelength_um, design.unit_cell.cell.period_nm, *map(file_mark, files))
    return _DIRECTIONS.of(key, lambda: _mean_direction(design, [_plain_term(design, term) for term in own]))


def _mean_direction(design: Design, terms: list[Term]) -> tuple[tuple[float, float], tuple[float, float]]:
    # Over a whole period: where the pillars alias a slope, the light goes into the direction of the alias.
    period_x_nm, period_y_nm = design.unit_cell.cell.period_nm
    slopes, inside = _slopes(design, terms, (1e-3 * period_x_nm, 1e-3 * period_y_nm)), _inside(design)
    mean = slopes[..., inside].sum(axis=-1) / max(1, np.count_nonzero(inside))
    cosines = mean * design.wavelength_um / (2.0 * np.pi)
    (x_x, x_y), (y_x, y_y) = cosines.tolist()
    return (x_x, x_y), (y_x, y_y)


def _places_um(design: Design) -> FloatArray:
    """Coordinates along a side of the aperture at which slopes are taken, shape (n,)."""
    return ((np.arange(_SLOPE_PLACES) + 0.5) / _SLOPE_PLACES - 0.5) * design.device.aperture_um


def _inside(design: Design) -> NDArray[np.bool_]:
    """Places of the slopes that lie within the aperture, shape (n, n)."""
    places = _places_um(design)
    return design.device.encloses(places, places)


def _slopes(
    design: Design, terms: Sequence[Term], step_um: tuple[float, float], counts: tuple[int, int] = (1, 1)
) -> FloatArray:
    """Mean slopes, rad/um, over ``counts`` wrapped steps along x and y.

    Shape (2, 2, n, n): polarisation, axis, and the places in rows along y.
    """
    places = _places_um(design)
    slopes = np.zeros((2, 2, places.size, places.size))
    for p, name in enumerate(POLARISATIONS):
        for axis, (step, count) in enumerate(zip(step_um, counts, strict=True)):
            phases = []
            for number in range(count + 1):
                x, y = (places + (number - 0.5 * count) * step * (axis == along) for along in (0, 1))
                phases.append(sum((term(x, y, name) for term in terms), np.zeros(slopes.shape[2:])))
            turned = sum(wrap_phase(after - before) for before, after in pairwise(phases))
            slopes[p, axis] = turned / (count * step)
    return slopes


def undersampled_share(design: Design) -> float:
    """Share of the aperture where the target phase is too steep for the lattice of the pillars.

    There it turns by more than pi from pillar to pillar, so that a flatter phase, with one turn per pillar less, has
    the same values and takes the light: the slope lies beyond the first Brillouin zone of the lattice. The larger share
    of both polarisations counts. The slope of an array is the mean of its steps from sample to sample over a few
    periods, since the interpolation between them is uneven. Terms with jumps, such as helices and holograms, are left
    out. An unusable array raises InputError.
    """
    period_um = 1e-3 * np.array(design.unit_cell.cell.period_nm)
    formulas = []
    slopes = np.zeros((2, 2, _SLOPE_PLACES, _SLOPE_PLACES))
    for term in design.phase:
        if isinstance(term, spec.UserArray):
            count_x, count_y = np.ceil(_WINDOW * period_um / term.pitch_um).astype(int).tolist()
            step_um = term.pitch_um, term.pitch_um
            slopes += _slopes(design, [_plain_term(design, term)], step_um, (count_x, count_y))
        elif term.is_smooth:
            formulas.append(_plain_term(design, term))
    near_x_um, near_y_um = (_LOCAL * period_um).tolist()
    slopes += _slopes(design, formulas, (near_x_um, near_y_um))
    along_x, along_y = 2.0 * np.pi / period_um
    # Shortest reciprocal lattice vectors, rad/um; every other row of a hexagonal lattice is offset by half a period.
    if design.unit_cell.cell.is_hexagonal:
        shortest = [(along_x, 0.5 * along_y), (along_x, -0.5 * along_y), (0.0, along_y)]
    else:
        shortest = [(along_x, 0.0), (0.0, along_y)]
    largest = 0.5 * (1.0 + _ROUNDING)
    beyond = [np.abs(slopes[:, 0] * gx + slopes[:, 1] * gy) > largest * (gx**2 + gy**2) for gx, gy in shortest]
    inside = _inside(design)
    return float(np.any(beyond, axis=0)[:, inside].mean(axis=-1).max()) if inside.any() else 0.0


def require_paintable(design: Design) -> None:
    """Raise InputError for pictures that cannot be read, are dark, or reach farther than the lattice can send light."""
    faults = []
    for number, term in enumerate(design.phase):
        if isinstance(term, spec.Picture):
            name = f"phase[{number}]"
            try:
                rows, columns = _picture(term).shape
            except InputError as error:
                faults += [Fault(f"{name}.file", f.expected, f.got, f.remedy) for f in error.faults]
                continue
            widest_um = _image_plane(design).widest_um((rows, columns))
            if term.width_um > widest_um:
                expected = f"at most {widest_um:.6g} um (wavelength times distance over period, along x and y)"
                faults.append(Fault(f"{name}.width_um", expected, f"{term.width_um:g} um", "narrow the picture"))
    if faults:
        raise InputError(design.name, faults)


def _hologram(design: Design, term: spec.Picture, progress: Progress) -> tuple[Term, PhaseFigures]:
    """The hologram of a picture, sampled at the lattice's sites, and its figures."""
    require_paintable(design)
    plane = _image_plane(design)
    sites = Pupil(int(design.device.aperture_um / plane.pitch_um + 1e-9), design.device.aperture_shape)
    hologram = design_hologram(_picture(term), term.width_um, plane, inside=sites.inside, progress=progress)
    field = np.stack([hologram.field, hologram.field])
    figures = PhaseFigures(hologram_efficiency=hologram.efficiency, hologram_correlation=hologram.correlation)
    return SampledPhase(field, plane.pitch_um, polarisation=term.polarisation), figures


def _picture(term: spec.Picture) -> FloatArray:
    picture = read_grey(term.file)
    if not np.isfinite(picture).all() or picture.min() < 0.0 or picture.max() == 0.0:
        least, most = float(picture.min()), float(picture.max())
        got = f"{least:g} to {most:g}" if math.isfinite(least + most) else "NaN or infinity"
        raise InputError.single(str(term.file), "values", "finite, none below zero, and some above", got)
    return picture


def _image_plane(design: Design) -> ImagePlane:
    pitch_um = 1e-3 * min(design.unit_cell.cell.period_nm)
    distance_um = _conjugates_um(design, design.sensor.focus_depth_m)[0]
    return ImagePlane(pitch_um=pitch_um, wavelength_um=design.wavelength_um, distance_um=distance_um)
