"""One incident wave through several layers, from the far side to the side of the light: by slabs, else by modes.

Behind a face every field is e = U w + e_s, h = V w + h_s, with w unknown and (e_s, h_s) the field of light from the far
side. For plane waves U and V are diagonal, or coupled in pairs (:mod:`metafab.cell.rcwa.scattering.half_space`).

**Slabs.** With Phi = P^-1 F and Gamma = P^-1 G of :mod:`metafab.cell.rcwa.scattering.doubling`, both symmetric, a
layer has

    h(0) = i (Phi e(0) - Gamma e(d)),         h(d) = i (Gamma e(0) - Phi e(d)),

so that w = T e(0) - c follows from (Phi U - i V) (T, c) = (Gamma, Phi e_s - i h_s), and where the layer begins

    h = i (Phi - Gamma U T) e + i Gamma (U c - e_s).

This is the pair of the next layer, with e in place of w. Phi has a pole where a layer is half a wave thick, and V one
where e has a node: digits are lost in proportion to their size. Light from the far side is solved along with the
incident light. Where rounding breaks the reciprocity of the two, or an admittance is too large, modes are used.

**Modes.** In a layer with modes E, H that decay by X from face to face, c+ taken where the layer begins and c- where it
ends, with S and D half the sum and half the difference of E^-1 U and H^-1 V,

    w = S^-1 X c+,    c- = D w,    and where it begins    e = E (1 + X D S^-1 X) c+,    h = H (1 - X D S^-1 X) c+.

This is the pair of the next layer, with c+ in place of w. Exponentials only decay. It is the R-matrix recursion of
multilayer gratings (Li, J. Opt. Soc. Am. A 13, 1024, 1996) for outgoing light alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metafab.cell.rcwa.basis.coordinates import Matrix
from metafab.cell.rcwa.scattering.doubling import CONSISTENT, slab
from metafab.cell.rcwa.scattering.half_space import Waves, as_matrices, magnetic
from metafab.cell.rcwa.scattering.modes import NO_MODES, FaceFields, conditioning, layer_modes
from metafab.core.conventions import ComplexArray

#: Largest admittance for which slabs are used: beyond it fewer than 11 digits are certain.
_LARGEST_ADMITTANCE = 1e5


@dataclass(frozen=True)
class StackLayer:
    """One layer."""

    p: Matrix  #: Shape (n, n), P of the layer.
    q: Matrix  #: Shape (n, n), Q of the layer.
    thickness_k0: float  #: Thickness times k0, from 0.
    largest_a: float  #: Bound on the real part of the eigenvalues of P Q; infinite where none is known.


def through_stack(
    layers: Sequence[StackLayer], incoming: Waves, outgoing: Waves, incident: ComplexArray, *, slabs: bool = True
) -> FaceFields:
    """Solve a stack for the field of the waves ``incident`` at its first and last face.

    Args:
        layers: from the side of the light to the far side.
        incoming: plane waves of the half space that the light comes from.
        outgoing: plane waves of the half space behind.
        incident: shape (n, p), transverse E of p incident waves where the first layer begins.
        slabs: whether slabs are tried before modes.
    """
    layers = [layer for layer in layers if layer.thickness_k0 > 0.0]
    faces = by_slabs(layers, incoming, outgoing, incident) if slabs else None
    return faces or by_modes(layers, incoming, outgoing, incident)


def by_slabs(
    layers: Sequence[StackLayer], incoming: Waves, outgoing: Waves, incident: ComplexArray
) -> FaceFields | None:
    """Solve a stack of layers of positive thickness by slabs; None where rounding is too large.

    Arguments are those of :func:`through_stack`; ``incident`` has the shape (n, p).
    """
    (e_in, h_in), (e_out, h_out) = as_matrices(incoming), as_matrices(outgoing)
    n, count = incident.shape
    passed, largest = [], 0.0
    try:
        near_h, far_h = magnetic(incoming, incident), h_out @ incident
        u, v, e_lit, h_lit = e_out, h_out, e_out @ incident, -far_h
        with np.errstate(all="ignore"):  # values that are not finite are refused below
            for layer in reversed(layers):
                both = slab(layer.p, layer.q, layer.thickness_k0, layer.largest_a)
                if both is None:
                    return None
                phi, gamma = both
                largest = max(largest, np.abs(phi).max(), np.abs(gamma).max(), np.abs(v).max())
                solved = np.linalg.solve(phi @ u - 1j * v, np.hstack([gamma, phi @ e_lit - 1j * h_lit]))
                onward, constant = solved[:, :n], solved[:, n:]  # T and c
                v, h_lit = 1j * (phi - gamma @ (u @ onward)), 1j * (gamma @ (u @ constant - e_lit))
                u, e_lit = np.eye(n, dtype=np.complex128), np.zeros_like(e_lit)
                passed.append(onward)
            # e = U w + e_s = E (a + r) and h = H (a - r) with incident and reflected amplitudes a and r, a = 0 for
            # light from the far side; H^T E is symmetric.
            sources = np.hstack([2.0 * h_in.T @ incident, -(h_in.T @ e_lit + e_in.T @ h_lit)])
            first = np.linalg.solve(h_in.T @ u + e_in.T @ v, sources)
            lit, back_lit = first[:, :count], first[:, count:]
            reflected, arriving = u @ lit - incident, u @ back_lit + e_lit
            for onward in reversed(passed):
                lit = onward @ lit
            transmitted = e_out @ lit
            # Lorentz reciprocity: transmission from the near to the far side, and back.
            scale = max(np.abs(near_h).max(), np.abs(far_h).max())
            inconsistency = float(np.abs(transmitted.T @ far_h - near_h.T @ arriving).max() / scale)
    except np.linalg.LinAlgError:
        return None
    # The comparisons fail for NaN too.
    trusted = inconsistency <= CONSISTENT and max(largest, np.abs(v).max()) <= _LARGEST_ADMITTANCE
    return FaceFields(transmitted, reflected, inconsistency) if trusted else None


def by_modes(layers: Sequence[StackLayer], incoming: Waves, outgoing: Waves, incident: ComplexArray) -> FaceFields:
    """Solve a stack of layers of positive thickness by the modes of every layer.

    Arguments are those of :func:`through_stack`; ``incident`` has the shape (n, p).
    """
    e_out, h_out = as_matrices(outgoing)
    e, h = e_out, h_out
    passed, worst = [], NO_MODES
    for layer in reversed(layers):
        modes = layer_modes(layer.p, layer.q)
        worst = worst.worse(conditioning(modes))
        decay = np.exp(1j * modes.beta * layer.thickness_k0)
        from_e, from_h = np.linalg.solve(modes.e, e), np.linalg.solve(modes.h, h)
        onward = np.linalg.solve(from_e + from_h, np.diag(2.0 * decay))
        echo = decay[:, None] * (0.5 * (from_e - from_h) @ onward)
        e, h = modes.e + modes.e @ echo, modes.h - modes.h @ echo
        passed.append(onward)
    # (H^T e + E^T h) w = 2 H^T e_inc, as by slabs.
    e_in, h_in = as_matrices(incoming)
    amplitudes = np.linalg.solve(h_in.T @ e + e_in.T @ h, 2.0 * h_in.T @ incident)
    reflected = e @ amplitudes - incident
    for onward in reversed(passed):
        amplitudes = onward @ amplitudes
    return FaceFields(e_out @ amplitudes, reflected, 0.0, worst)
