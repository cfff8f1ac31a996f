"""Choice of [L, epsilon] of spiral zones (Eq. 2 of Shen 2023) for a range of depths and its noise.

Few zones turn fast, many turn slowly and reach far.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.errors import Fault, InputError
from metafab.information.texture import Texture
from metafab.phase.optimise.blind import BlindInformation
from metafab.phase.optimise.rotation import full_turn_dioptre, helix_half_width, main_lobe, rotation_deg_per_dioptre
from metafab.phase.pupil import Pupil, rim_defocus_per_dioptre_rad, rim_defocus_rad
from metafab.phase.terms.helices import spiral_field

#: Pupil samples a side; the texture has twice as many Nyquist pixels a side.
_SAMPLES = 48
#: Pupil samples a side for the lobe, whose orientation is sensitive to square samples at the zones' boundaries.
_LOBE_SAMPLES = 128
#: Depths at which the bound is evaluated.
_DEPTHS = 12
#: Largest turn over the range, degrees: larger ones come close to ambiguity.
_LARGEST_TURN_DEG = 330.0


@dataclass(frozen=True)
class Proposal:
    """One choice of [L, epsilon] over a range of depths."""

    zones: int  #: L, number of spiral zones.
    exponent: float  #: epsilon, exponent of the zones' radii.
    focus_depth_m: float  #: Depth in focus on the sensor, the middle of the range in vergence.
    #: Turn of the main lobe from the nearest to the farthest depth, measured at the level of the pupil.
    rotation_deg: float
    rotation_deg_per_dioptre: float  #: Law of rotation (epsilon = 1/2).
    full_turn_dioptre: float  #: Range of vergence after which the orientation repeats.
    depth_m: FloatArray  #: Shape (n_depth,), depths, evenly spaced in vergence, ascending.
    #: Shape (n_depth,), orientation of the main lobe, measured at the level of the pupil, unwrapped.
    phi_deg: FloatArray
    #: Shape (n_depth,), Cramer-Rao bound of depth from twin images of a patch of unknown texture of 96 x 96 Nyquist
    #: pixels of lambda s' / (4 R); in inverse proportion to the root of the area.
    crlb_m: FloatArray

    @property
    def relative_error(self) -> float:
        """Mean of ``crlb_m / depth_m``."""
        return float(np.mean(self.crlb_m / self.depth_m))


def propose(
    nearest_m: float,
    farthest_m: float,
    *,
    aperture_um: float,
    wavelength_um: float,
    texture: Texture | None = None,
    zones: Iterable[int] = range(2, 13),
    exponents: Iterable[float] = (0.4, 0.5, 0.6),
) -> tuple[Proposal, ...]:
    """Return the plain spirals whose lobe turns monotonically and less than once, smallest relative error first.

    Args:
        nearest_m: nearest depth.
        farthest_m: farthest depth, finite.
        texture: unknown texture and noise, per Nyquist pixel.
        zones: candidates for L.
        exponents: candidates for epsilon.

    Raises:
        InputError: the range is empty, aperture or wavelength are no lengths, or no candidate keeps a single turn over
            the range.
    """
    if not 0.0 < nearest_m < farthest_m < math.inf:
        expected = "0 < nearest < farthest, both finite"
        raise InputError.single("propose", "depths", expected, f"{nearest_m}, {farthest_m}")
    lengths = {"aperture_um": aperture_um, "wavelength_um": wavelength_um}
    if faults := [
        Fault(name, "a finite length above 0", f"{length:g} um")
        for name, length in lengths.items()
        if not 0.0 < length < math.inf
    ]:
        raise InputError("propose", faults)
    radius_um = 0.5 * aperture_um
    vergence = np.linspace(1.0 / nearest_m, 1.0 / farthest_m, _DEPTHS)
    span = float(vergence[0] - vergence[-1])
    depth_m, focus_m = 1.0 / vergence, 2.0 / float(vergence[0] + vergence[-1])
    defocus = rim_defocus_rad(depth_m, focus_m, radius_um, wavelength_um)
    per_dioptre = rim_defocus_per_dioptre_rad(radius_um, wavelength_um)
    pupil, fine = Pupil(_SAMPLES), Pupil(_LOBE_SAMPLES)
    problem = BlindInformation(pupil, defocus, texture or Texture())
    proposals = []
    for count in zones:
        rate = rotation_deg_per_dioptre(count, radius_um, wavelength_um)
        if abs(rate) * span > _LARGEST_TURN_DEG or count < 2:
            continue
        track = np.linspace(defocus[0], defocus[-1], max(_DEPTHS, 4 * math.ceil(abs(defocus[0]) / count) + 2))
        for exponent in exponents:
            phi_deg = main_lobe(fine, spiral_field(fine, count, exponent), track, helix_half_width(count)).phi_deg
            turn_deg = float(phi_deg[-1] - phi_deg[0])
            if np.any(np.diff(phi_deg) <= 0.0) or turn_deg > _LARGEST_TURN_DEG:
                continue
            information = problem.of_field(spiral_field(pupil, count, exponent))
            crlb_m = depth_m**2 / per_dioptre / np.sqrt(information)
            repeat = full_turn_dioptre(count, radius_um, wavelength_um)
            # Defocus falls with depth, and so does the track; np.interp needs ascending positions.
            at_depth = np.interp(-defocus, -track, phi_deg)
            proposals.append(Proposal(count, exponent, focus_m, turn_deg, rate, repeat, depth_m, at_depth, crlb_m))
    if not proposals:
        needed = math.ceil(math.degrees(per_dioptre) * span / _LARGEST_TURN_DEG)
        expected = f"candidates that turn at most {_LARGEST_TURN_DEG:g} degrees over {span:.3g} dioptres"
        remedy = f"allow L >= {needed}, shorten the range, or make the aperture smaller"
        raise InputError.single("propose", "zones", expected, "none", remedy)
    return tuple(sorted(proposals, key=lambda proposal: proposal.relative_error))
