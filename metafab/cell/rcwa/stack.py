"""One incident wave through several layers by their modes, from the far side to the side of the light.

Behind a face every outgoing field is e = U w, h = V w. For plane waves U and V are diagonal, or in pairs
(:mod:`metafab.cell.rcwa.birefringence`). In a layer with modes E, H
that decay by X from face to face, c+ taken where the layer begins and c- where it ends, the far face asks

    X c+ + c- = E^-1 U w,    X c+ - c- = H^-1 V w,

so that with S and D half the sum and half the difference of E^-1 U and H^-1 V

    w = S^-1 X c+,    c- = D w,    and where it begins    e = E (1 + X D S^-1 X) c+,    h = H (1 - X D S^-1 X) c+:

a pair for the next layer, with c+ in place of w. Exponentials only decay, however thick a layer is. It is the
R-matrix recursion of multilayer gratings (Li, J. Opt. Soc. Am. A 13, 1024, 1996) for outgoing light alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from metafab.cell.rcwa.birefringence import TensorWaves, as_matrices
from metafab.cell.rcwa.conditioning import Conditioning, conditioning
from metafab.cell.rcwa.doubling import Faces
from metafab.cell.rcwa.eigenmodes import LayerModes, PlaneWaves
from metafab.core.conventions import ComplexArray


@dataclass(frozen=True)
class StackLayer:
    """Modes of one layer, and its thickness times k0."""

    modes: LayerModes
    thickness_k0: float


def through_stack(
    layers: Sequence[StackLayer],
    incoming: PlaneWaves | TensorWaves,
    outgoing: PlaneWaves | TensorWaves,
    incident: ComplexArray,
) -> Faces:
    """Field of the waves ``incident`` at the first and the last face.

    Args:
        layers: from the side of the light to the far side.
        incoming: plane waves of the half space that the light comes from.
        outgoing: plane waves of the half space behind.
        incident: shape (n, p), transverse E of p incident waves where the first layer begins.
    """
    e_out, h_out = as_matrices(outgoing)
    e, h = e_out, h_out
    passed = []
    for layer in reversed(layers):
        modes, decay = layer.modes, np.exp(1j * layer.modes.beta * layer.thickness_k0)
        from_e, from_h = np.linalg.solve(modes.e, e), np.linalg.solve(modes.h, h)
        onward = np.linalg.solve(from_e + from_h, np.diag(2.0 * decay))
        echo = decay[:, None] * (0.5 * (from_e - from_h) @ onward)
        e, h = modes.e + modes.e @ echo, modes.h - modes.h @ echo
        passed.append(onward)
    # e w = E (a + r) and h w = H (a - r) for incident and reflected amplitudes a and r; H^T E is symmetric, so that
    # (H^T e + E^T h) w = 2 H^T e_inc.
    e_in, h_in = as_matrices(incoming)
    amplitudes = np.linalg.solve(h_in.T @ e + e_in.T @ h, 2.0 * h_in.T @ incident)
    reflected = e @ amplitudes - incident
    for onward in reversed(passed):
        amplitudes = onward @ amplitudes
    worst = reduce(Conditioning.worse, (conditioning(layer.modes) for layer in layers))
    return Faces(e_out @ amplitudes, reflected, 0.0, worst)
