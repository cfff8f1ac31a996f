"""A lattice that samples target phases which no pillar will follow: as coarse as their steepest slope allows."""

from __future__ import annotations

import math

import numpy as np

from metafab.layout.geometry import aperture_dbu, lattice_of
from metafab.layout.pillars import Lattice
from metafab.phase import PhaseProfile
from metafab.spec import Design
from metafab.spec.outline import encloses

#: Places a side at which the slope is taken.
_PLACES = 181
#: Sites across the aperture, at least: its rim is sampled, too.
_FEWEST_SITES = 1000
#: Share of them that may be steeper: steps between zones are no slopes.
_STEPS = 0.02
#: Of the half turn between samples at which a wave folds into another direction.
_SHARE_OF_NYQUIST = 0.9


def sampling_lattice(profile: PhaseProfile, design: Design) -> Lattice:
    """A square of sites a whole number of periods apart, centred on the axis, over the aperture.

    The phase of the light, not only what is left of it behind lens and split, turns by less than half a turn from a
    site to the next nearly everywhere: what leaves the sites goes to the image and to no ghost of it in the window.
    A lens that is not much steeper than its lattice allows is sampled by the lattice itself.

    Raises:
        InputError: as :func:`lattice_of`.
    """
    fine = lattice_of(design)
    period, aperture = max(fine.cell_dbu), aperture_dbu(design)
    turn_rad = _turn_rad(profile, design, period * fine.database_unit_nm * 1e-3)
    periods = min(math.floor(_SHARE_OF_NYQUIST * math.pi / max(turn_rad, 1e-9)), aperture // (_FEWEST_SITES * period))
    if periods < 2:
        return fine
    pitch = periods // 2 * 2 * period  # Even, so that sites beside the axis are whole.
    count = aperture // pitch
    return Lattice((pitch, pitch), (count, count), fine.database_unit_nm)


def _turn_rad(profile: PhaseProfile, design: Design, step_um: float) -> float:
    """The most by which either polarisation's phase turns within a step along x or y, but for a few places."""
    half_um = 0.5 * design.device.aperture_um - step_um
    places_um = np.linspace(-half_um, half_um, _PLACES)
    pairs_um = np.stack([places_um, places_um + step_um], axis=1).ravel()
    inside = encloses(design.device, places_um, places_um)
    along_x = np.diff(profile(pairs_um, places_um).reshape(2, _PLACES, _PLACES, 2), axis=3)[..., 0]
    along_y = np.diff(profile(places_um, pairs_um).reshape(2, _PLACES, 2, _PLACES), axis=2)[:, :, 0]
    turns_rad = np.abs(np.angle(np.exp(1j * np.stack([along_x, along_y]))))[..., inside]
    return float(np.quantile(turns_rad, 1.0 - _STEPS))
