"""Which [L, epsilon] suits a depth range and its noise: few zones turn fast, many turn slowly and reach far."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.information.twin_images import Texture
from metafab.phase.optimise.blind import BlindInformation
from metafab.phase.optimise.peak import spiral_field
from metafab.phase.optimise.rotation import full_turn_dioptre, main_lobe, rotation_deg_per_dioptre
from metafab.phase.pupil import Pupil, rim_defocus_per_dioptre_rad, rim_defocus_rad

#: Pupil samples a side; the information is that of a piece of texture of twice as many Nyquist pixels a side.
_SAMPLES = 48
#: Pupil samples a side for the lobe, whose orientation suffers from squared-off zones first.
_LOBE_SAMPLES = 128


@dataclass(frozen=True)
class Proposal:
    """One choice of [L, epsilon] over a depth range.

    Attributes:
        zones: L of Eq. 2.
        exponent: epsilon of Eq. 2.
        focus_depth_m: where the sensor is to stand: the middle of the range in vergence.
        rotation_deg: turn of the main lobe from the nearest to the farthest depth, measured at the pupil level.
        rotation_deg_per_dioptre: by theory (epsilon = 1/2).
        full_turn_dioptre: range of vergence after which the orientation repeats.
        depth_m: shape (n_depth,), depths, evenly spaced in vergence, ascending.
        phi_deg: shape (n_depth,), orientation of the main lobe, measured at the pupil level, unwrapped.
        crlb_m: shape (n_depth,), smallest standard deviation of depth from the twin image of a piece of unknown
            texture of 96 x 96 Nyquist pixels of lambda s' / (4 R); goes with one over the root of the area.
    """

    zones: int
    exponent: float
    focus_depth_m: float
    rotation_deg: float
    rotation_deg_per_dioptre: float
    full_turn_dioptre: float
    depth_m: FloatArray
    phi_deg: FloatArray
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
    largest_turn_deg: float = 330.0,
    depths: int = 12,
) -> tuple[Proposal, ...]:
    """Plain spirals whose lobe turns monotonically and less than once over a depth range, the most telling first.

    Args:
        nearest_m: nearest depth.
        farthest_m: farthest depth, finite.
        aperture_um: diameter.
        wavelength_um: vacuum wavelength.
        texture: unknown texture and noise, per Nyquist pixel.
        zones: candidates for L.
        exponents: candidates for epsilon.
        largest_turn_deg: larger turns come too close to ambiguity.
        depths: at which the bound is evaluated, at least 4.

    Raises:
        InputError: the range is empty, or no candidate keeps a single turn over it.
    """
    if not 0.0 < nearest_m < farthest_m < math.inf:
        raise InputError.single(
            "propose", "depths", "0 < nearest < farthest, both finite", f"{nearest_m}, {farthest_m}"
        )
    radius_um = 0.5 * aperture_um
    vergence = np.linspace(1.0 / nearest_m, 1.0 / farthest_m, depths)
    depth_m, focus_m = 1.0 / vergence, 2.0 / float(vergence[0] + vergence[-1])
    defocus = rim_defocus_rad(depth_m, focus_m, radius_um, wavelength_um)
    per_dioptre = rim_defocus_per_dioptre_rad(radius_um, wavelength_um)
    pupil, fine = Pupil(_SAMPLES), Pupil(_LOBE_SAMPLES)
    problem = BlindInformation(pupil, defocus, texture or Texture())
    found = []
    for count in zones:
        rate = rotation_deg_per_dioptre(count, radius_um, wavelength_um)
        if abs(rate) * float(vergence[0] - vergence[-1]) > largest_turn_deg or count < 2:
            continue
        for exponent in exponents:
            field = spiral_field(pupil, count, exponent)
            track = np.linspace(defocus[0], defocus[-1], max(depths, 4 * math.ceil(abs(defocus[0]) / count) + 2))
            phi_deg = main_lobe(fine, spiral_field(fine, count, exponent), track, 2.0 * count + 6.0).phi_deg
            turn_deg = float(phi_deg[-1] - phi_deg[0])
            if np.any(np.diff(phi_deg) <= 0.0) or turn_deg > largest_turn_deg:
                continue
            crlb_m = depth_m**2 / per_dioptre / np.sqrt(problem.of_field(field))
            repeat = full_turn_dioptre(count, radius_um, wavelength_um)
            # Defocus falls with depth, and so does the track; np.interp wants it rising.
            at_depth = np.interp(-defocus, -track, phi_deg)
            found.append(Proposal(count, exponent, focus_m, turn_deg, rate, repeat, depth_m, at_depth, crlb_m))
    if not found:
        span = float(vergence[0] - vergence[-1])
        needed = math.degrees(per_dioptre) * span / largest_turn_deg
        raise InputError.single(
            "propose",
            "zones",
            f"candidates that turn at most {largest_turn_deg:g} degrees over {span:.3g} dioptres",
            "none",
            f"allow L >= {math.ceil(needed)}, shorten the range, or make the aperture smaller",
        )
    return tuple(sorted(found, key=lambda proposal: proposal.relative_error))
