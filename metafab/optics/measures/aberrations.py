"""Wavefront behind a lens against the sphere about its image point, and its Zernike polynomials.

The path of the ray to the image point is removed at every pillar, and blocks of pillars are summed. The phase of a
block's sum is the wavefront error, positive where light arrives late. It is unwrapped by least squares: polynomials
are fitted to the phase steps between neighbouring blocks, and the residual is within half a wave.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import POLARISATIONS, FloatArray
from metafab.core.errors import InputError
from metafab.core.figures import AberrationFigures
from metafab.core.parallel.work import Work
from metafab.optics.geometry.imaging import Imaging
from metafab.optics.geometry.path import Ray
from metafab.optics.propagation.pupil import Carrier, Pupil, reduce_field
from metafab.optics.sources.source import Source
from metafab.phase.terms.zernike import ZernikePhase, zernike_number

#: Polynomials of the fit: all of degree n up to 7 (Noll), or of n + |m| up to 10 (fringe).
TERMS = 36
#: Blocks across the aperture, at least: aberrations of up to half a wave from one to the next are unwrapped.
_BLOCKS = 96
#: Blocks across the stored map, at most.
_SHOWN = 48
#: Power of a block over the mean, below which it counts as dark.
_LEAST_POWER = 0.1

_Convention = Literal["noll", "fringe"]


def aberrations(
    source: Source, imaging: Imaging, depth_m: float, *, polarisation: int = 0, work: Work = Work()
) -> AberrationFigures:
    """Return the wavefront error of a polarisation (0 for x, 1 for y) for an object on the axis.

    InputError if too few blocks transmit light for the polynomials.
    """
    ray = Ray.towards_image(imaging, polarisation, depth_m, (0.0, 0.0))
    sites = min(source.lattice.shape)
    carrier = Carrier(polarisation, ray, max(1, sites // _BLOCKS))
    (pupil,) = reduce_field(source, [carrier], imaging.wavenumber, work)
    radius_um = 0.5 * imaging.aperture_um
    lit = _lit(pupil, radius_um)
    if np.count_nonzero(lit) < 2 * TERMS:
        got = f"{np.count_nonzero(lit)} blocks of pillars with light"
        raise InputError.single("optics", "aberrations", f"{2 * TERMS} or more", got, "is the aperture large enough?")
    noll, fringe = (_polynomials(pupil, radius_um, convention) for convention in ("noll", "fringe"))
    phase = _unwrapped(pupil, lit, noll)
    waves = phase / (2.0 * math.pi)
    weight = pupil.power[lit] / pupil.power[lit].sum()
    # A tilt moves the image and does not blur it.
    plane = noll[:3, lit]
    level = waves - _fitted(plane, waves, weight) @ plane
    of_noll, of_fringe = (_fitted(basis[:, lit], waves, weight) for basis in (noll, fringe))
    residual = math.sqrt(float(weight @ (waves - of_noll @ noll[:, lit]) ** 2))
    field = np.sqrt(pupil.power[lit]) * np.exp(2j * math.pi * level)
    opd = np.full(lit.shape, np.nan)
    opd[lit] = level
    every = -(-max(lit.shape) // _SHOWN)
    return AberrationFigures(
        polarisation=POLARISATIONS[polarisation],
        depth_m=depth_m,
        radius_um=radius_um,
        rms_waves=math.sqrt(float(weight @ level**2)),
        residual_waves=residual,
        strehl_of_phase=float(abs(field.sum()) ** 2 / np.abs(field).sum() ** 2),
        noll_waves=of_noll,
        fringe_waves=of_fringe,
        x_um=pupil.x_um[::every],
        y_um=pupil.y_um[::every],
        opd_waves=opd[::every, ::every],
    )


def _lit(pupil: Pupil, radius_um: float) -> NDArray[np.bool_]:
    """Blocks that lie within the circle as a whole and transmit, shape (n_y, n_x)."""
    half_x, half_y = (0.5 * side for side in pupil.block_um)
    corner = np.hypot(np.abs(pupil.x_um) + half_x, (np.abs(pupil.y_um) + half_y)[:, None])
    power = pupil.power[(corner <= radius_um) & (pupil.power > 0.0)]
    return np.asarray((corner <= radius_um) & (pupil.power > _LEAST_POWER * (power.mean() if power.size else np.inf)))


def _polynomials(pupil: Pupil, radius_um: float, convention: _Convention) -> FloatArray:
    """The first polynomials at the blocks, shape (TERMS, n_y, n_x)."""
    terms = []
    for number in range(1, TERMS + 1):
        degree, order, norm = zernike_number(number, convention)
        terms.append(
            ZernikePhase(degree=degree, order=order, amplitude_rad=norm, radius_um=radius_um)(
                pupil.x_um, pupil.y_um, "x"
            )
        )
    return np.array(terms)


def _unwrapped(pupil: Pupil, lit: NDArray[np.bool_], basis: FloatArray) -> FloatArray:
    """Phase of the lit blocks, rad, without jumps of whole turns; shape (n,)."""
    rows, steps = [], []
    for axis in (-2, -1):
        sums, shapes = np.moveaxis(pupil.sums[0], axis, 0), np.moveaxis(basis, axis, 1)
        shown = np.moveaxis(lit, axis, 0)
        both = shown[1:] & shown[:-1]
        steps.append(np.angle((sums[1:] * sums[:-1].conj())[both]))
        rows.append(np.diff(shapes, axis=1)[:, both])
    # The first polynomial is constant and has no steps.
    coefficients = np.linalg.lstsq(np.concatenate(rows, axis=1)[1:].T, np.concatenate(steps), rcond=None)[0]
    smooth = coefficients @ basis[1:, lit]
    turned = pupil.sums[0][lit] * np.exp(-1j * smooth)
    piston = float(np.angle(turned.sum()))
    return np.asarray(smooth + piston + np.angle(turned * np.exp(-1j * piston)))


def _fitted(basis: FloatArray, waves: FloatArray, weight: FloatArray) -> FloatArray:
    """Coefficients of weighted least squares, shape (TERMS,)."""
    root = np.sqrt(weight)
    return np.asarray(np.linalg.lstsq((basis * root).T, waves * root, rcond=None)[0])
