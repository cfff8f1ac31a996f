"""A design's phase terms as one profile, with its helices optimised and its holograms designed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from metafab.core.arguments import require_types
from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.figures import PhaseFigures
from metafab.core.numeric.phasor import phasor
from metafab.core.parallel.executor import one_blas_thread
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.tables import applicable
from metafab.information.texture import Texture
from metafab.phase.formulas import plain_term
from metafab.phase.optimise.blind import BlindDesign, BlindInformation, optimise_blind
from metafab.phase.optimise.peak import PeakDesign, optimise_peak
from metafab.phase.optimise.rotation import helix_half_width, main_lobe, ring_rotation, rotation_deg_per_dioptre
from metafab.phase.optimise.side_lobes import SideLobeDesign, limit_side_lobes
from metafab.phase.picture import hologram_of
from metafab.phase.pupil import Pupil, pupil_field, rim_defocus_rad
from metafab.phase.terms.helices import SpiralZonesPhase, spiral_field
from metafab.phase.terms.profile import PhaseProfile, Term
from metafab.phase.terms.sampled import SampledMask
from metafab.spec import terms as spec
from metafab.spec.design import Design

#: Depths at which the rotation is measured; between neighbours the lobe turns by less than half a turn.
_ROTATION_DEPTHS = 49
#: Depths of the search for information.
_BLIND_DEPTHS = 10
#: Pupil samples a side of a helix whose samples are free: of largest information, or with limited side lobes.
_SEARCH_SAMPLES = 64


@one_blas_thread()
def profile_of(design: Design, *, progress: Progress = silent) -> PhaseProfile:
    """Build the target phase of a design, the sum of its phase terms, with its key figures.

    ``spiral_zones`` is optimised as its ``optimise`` says, for the aperture of the design and over one full turn of the
    lobe. An unusable array or picture, and two terms with spiral zones for one polarisation, raise InputError.
    """
    require_types("phase", design=(design, Design))
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
            term, added = hologram_of(design, spec_term, progress)
        else:
            term, added = plain_term(design, spec_term), PhaseFigures()
        terms.append(term)
        figures = replace(figures, **applicable(added))
    return PhaseProfile(tuple(terms), figures)


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
