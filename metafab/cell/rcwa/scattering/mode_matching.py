"""Mode matching of one layer between two half spaces, with amplitudes at the faces where the modes start.

Inside the layer c+ is taken at the side of the light and c- at the far side, so that exponentials only decay: a pillar
may be tall, and a mode strongly evanescent. Modes that die before they reach the other side leave the coupled problem.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metafab.cell.rcwa.scattering.half_space import PlaneWaves
from metafab.cell.rcwa.scattering.modes import LayerModes
from metafab.core.conventions import ComplexArray

#: Smallest share of a mode at the other side that still couples the two faces.
_NEGLIGIBLE = 1e-18


@dataclass(frozen=True)
class LayerField:
    """Field of p incident waves in a layer and at its two faces.

    Attributes:
        forward: shape (n, p), c+ of each mode where the layer begins (the side of the light).
        backward: shape (n, p), c- of each mode where the layer ends.
        transmitted: shape (n, p), transverse E where the layer ends.
        reflected: shape (n, p), transverse E of the reflected waves where the layer begins.
    """

    forward: ComplexArray
    backward: ComplexArray
    transmitted: ComplexArray
    reflected: ComplexArray


def through_layer(
    modes: LayerModes, thickness_k0: float, incoming: PlaneWaves, outgoing: PlaneWaves, incident: ComplexArray
) -> LayerField:
    """Solve one layer for the field of the waves ``incident``.

    Args:
        modes: n modes of the layer.
        thickness_k0: thickness times k0.
        incoming: plane waves of the half space that the light comes from.
        outgoing: plane waves of the half space behind.
        incident: shape (n, p), transverse E of p incident waves where the layer begins.
    """
    decay = np.exp(1j * modes.beta * thickness_k0)
    carried = np.flatnonzero(np.abs(decay) > _NEGLIGIBLE)
    decay = decay[carried, None]
    near_e, near_h = incoming.h[:, None] * modes.e, incoming.e[:, None] * modes.h
    far_e, far_h = outgoing.h[:, None] * modes.e, outgoing.e[:, None] * modes.h
    # Where it begins:  (near_e + near_h) c+ + (near_e - near_h) X c- = 2 h_in e_inc, with X the decay;
    # where it ends:    (far_e + far_h) c- + (far_e - far_h) X c+ = 0.
    source = 2.0 * incoming.h[:, None] * incident
    started = np.linalg.solve(
        near_e + near_h, np.concatenate([source, (near_e - near_h)[:, carried] * decay.T], axis=1)
    )
    count = incident.shape[1]
    started, returned = started[:, :count], started[:, count:]
    turned = np.linalg.solve(far_e + far_h, (far_e - far_h)[:, carried] * decay.T)
    echo = np.eye(carried.size) - returned[carried] @ turned[carried]
    arriving = np.linalg.solve(echo, started[carried])
    backward = -turned @ arriving
    forward = started - returned @ backward[carried]
    at_end, at_begin = backward.copy(), forward.copy()
    at_end[carried] += decay * arriving
    at_begin[carried] += decay * backward[carried]
    return LayerField(forward, backward, modes.e @ at_end, modes.e @ at_begin - incident)
