"""One incident wave through one layer between two half spaces, by outgoing amplitudes only.

Inside the layer c+ is taken where it starts (the side of the light) and c- where it starts (the far side), so that
exponentials only decay and a pillar may be tall, or a mode strongly evanescent. Modes that die before they reach the
other side leave the coupled problem.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lu_factor, lu_solve

from metafab.cell.rcwa.eigenmodes import LayerModes, PlaneWaves
from metafab.core.conventions import ComplexArray

#: A mode with less than this left at the other side is not carried over.
_NEGLIGIBLE = 1e-18


def through_layer(
    modes: LayerModes, thickness_k0: float, incoming: PlaneWaves, outgoing: PlaneWaves, incident: ComplexArray
) -> tuple[ComplexArray, ComplexArray]:
    """Transmitted and reflected transverse E for incident waves of transverse E ``incident``.

    Args:
        modes: of the layer, n modes.
        thickness_k0: thickness times k0.
        incoming: plane waves of the half space that the light comes from.
        outgoing: plane waves of the half space behind.
        incident: shape (n, p), E of p incident waves at the near side of the layer.

    Returns:
        E at the far side of the layer and the reflected E at its near side, each of shape (n, p).
    """
    decay = np.exp(1j * modes.beta * thickness_k0)
    carried = np.flatnonzero(np.abs(decay) > _NEGLIGIBLE)
    decay = decay[carried]
    near_e, near_h = incoming.h[:, None] * modes.e, incoming.e[:, None] * modes.h
    far_e, far_h = outgoing.h[:, None] * modes.e, outgoing.e[:, None] * modes.h
    # near: (near_e + near_h) c+ + (near_e - near_h) X c- = 2 h_1 e_inc;  far: the same mirrored, without source.
    source = 2.0 * incoming.h[:, None] * incident
    near = np.concatenate([source, (near_e - near_h)[:, carried] * decay], axis=1)
    near = lu_solve(lu_factor(near_e + near_h, check_finite=False), near, check_finite=False)
    far = (far_e - far_h)[:, carried] * decay
    far = lu_solve(lu_factor(far_e + far_h, check_finite=False), far, check_finite=False)
    count = incident.shape[1]
    started, returned = near[:, :count], near[:, count:]
    # c+ = started - returned c-[carried],  c- = -far c+[carried]
    forward_carried = np.linalg.solve(np.eye(carried.size) - returned[carried] @ far[carried], started[carried])
    backward = -far @ forward_carried
    forward = started - returned @ backward[carried]
    backward_near, forward_far = np.zeros_like(backward), np.zeros_like(forward)
    backward_near[carried] = decay[:, None] * backward[carried]
    forward_far[carried] = decay[:, None] * forward_carried
    transmitted = modes.e @ (forward_far + backward)
    reflected = modes.e @ (forward + backward_near) - incident
    return transmitted, reflected
