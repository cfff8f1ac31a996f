"""Which pillar, turned by which angle, stands at each site: the one whose Jones matrix is nearest to the target.

A turned pillar's matrix is taken as R(-a) diag(t_x, t_y) R(a) of the library's: that of a pillar whose square lattice
is turned with it. The pillars' lattice does not turn, so this is the local-period approximation once more, in angle.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.errors import InputError
from metafab.core.parallel.progress import Progress, silent
from metafab.layout import Lattice, lattice_of
from metafab.library import Library
from metafab.materials import refractive_index
from metafab.optics.sources.source import FieldTile
from metafab.spec import Design
from metafab.spec.outline import encloses
from metafab.stokes.target import StokesProfile

_ROWS = 16
#: Global phases that are tried: the library's covers the circle unevenly.
_PHASES = 8
_PROBED_SITES = 4000


@dataclass(frozen=True)
class TurnedPillars:
    """Pillars of some sizes and angles on a lattice.

    Attributes:
        lattice: where the sites are.
        index: shape (n_y, n_x), 0 for no pillar, else 1 + row of ``kinds``.
        kinds: shape (n, 3), width nm, length nm, angle in degrees counter-clockwise, of each kind.
        jones: shape (n + 1, 3), power-normalised entries xx, xy = yx, yy of each index; none for 0.
        overlap: share of the target's power that the chosen matrices have in common with it, 0 to 1.
    """

    lattice: Lattice
    index: NDArray[np.uint16]
    kinds: FloatArray
    jones: ComplexArray
    overlap: float

    def tiles(self) -> Iterator[FieldTile]:
        """The whole as one tile; its "polarisations" are the entries xx, xy and yy."""
        yield FieldTile(0, 0, self.index, self.jones)


def turned(t_x: ComplexArray, t_y: ComplexArray, angle_rad: FloatArray) -> ComplexArray:
    """Entries xx, xy = yx, yy of R(-a) diag(t_x, t_y) R(a): shape (3, ...)."""
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    return np.stack(
        [cosine**2 * t_x + sine**2 * t_y, cosine * sine * (t_x - t_y), sine**2 * t_x + cosine**2 * t_y]
    ).astype(np.complex128)


def candidates(library: Library, design: Design, angles: int, size_step_nm: float) -> tuple[FloatArray, ComplexArray]:
    """Sizes and angles whose bounding box keeps the gap, shape (n, 3), and their Jones entries, shape (n, 3).

    Raises:
        InputError: the rules leave no pillar.
    """
    rules, cell = design.rules, design.unit_cell.cell
    sides = [np.arange(axis[0], axis[-1] + 1e-6, size_step_nm) for axis in (library.width_nm, library.length_nm)]
    angle_deg = np.arange(angles) * 180.0 / angles
    width, length, angle = (a.ravel() for a in np.meshgrid(*sides, angle_deg, indexing="ij"))
    cosine, sine = np.abs(np.cos(np.radians(angle))), np.abs(np.sin(np.radians(angle)))
    room = np.broadcast_to(cell.period_nm, 2) - rules.min_gap_nm + 1e-6
    kept = (width * cosine + length * sine <= room[0]) & (width * sine + length * cosine <= room[1])
    # A quarter of a turn exchanges the sides: each pillar is listed once.
    kept &= angle < 90.0
    kept &= np.minimum(width, length) >= design.min_side_nm
    if not kept.any():
        raise InputError.single(
            design.name, "rules.min_gap_nm", "a gap that leaves room for turned pillars", f"{rules.min_gap_nm:g} nm",
            "make it smaller",
        )  # fmt: skip
    kinds = np.stack([width, length, angle], axis=1)[kept]
    return kinds, jones_of(library, design, kinds)


def jones_of(library: Library, design: Design, kinds: FloatArray) -> ComplexArray:
    """Power-normalised entries xx, xy = yx, yy, shape (n, 3), of pillars of width, length and angle, shape (n, 3)."""
    illumination, materials = design.unit_cell.illumination, design.unit_cell.materials
    substrate, ambient = (
        refractive_index(medium, illumination.wavelength_nm) for medium in (materials.substrate, materials.ambient)
    )
    n_in, n_out = (substrate, ambient) if illumination.side == "substrate" else (ambient, substrate)
    response = library.at_sizes(kinds[:, 0], kinds[:, 1])
    t_x, t_y = (
        t * np.sqrt(n_out[axis].real / n_in[axis].real) for axis, t in enumerate((response.t_xx, response.t_yy))
    )
    return turned(t_x, t_y, np.radians(kinds[:, 2])).T


def assign(
    profile: StokesProfile,
    library: Library,
    design: Design,
    *,
    angles: int = 16,
    size_step_nm: float = 6.0,
    progress: Progress = silent,
) -> TurnedPillars:
    """The pillar of each site.

    Args:
        profile: target matrices.
        library: phases and amplitudes over width and length.
        design: lattice, aperture, gap rule (kept by the turned pillars' bounding boxes).
        angles: how many in half a turn; even, so that both diagonals are among them.
        size_step_nm: step of the sizes that are tried.
        progress: called while sites are mapped.

    Raises:
        InputError: the gap leaves no room for any pillar.
    """
    lattice = lattice_of(design)
    kinds, jones = candidates(library, design, angles, size_step_nm)
    x_um, y_um = lattice.x_um(), lattice.y_um()
    scale = _scale(profile, x_um, y_um, jones)
    # |target / scale - J|^2 is least where 2 Re<target, J> scale - |J|^2 is largest.
    weight = np.array([1.0, math.sqrt(2.0), 1.0])
    table = np.concatenate([(jones * weight).real, (jones * weight).imag], axis=1).astype(np.float32).T
    penalty = (0.5 * np.sum(np.abs(jones * weight) ** 2, axis=1)).astype(np.float32)
    index = np.zeros(lattice.shape, dtype=np.uint16)
    common = power = spent = 0.0
    for row in range(0, y_um.size, _ROWS):
        inside = encloses(design.device, x_um, y_um[row : row + _ROWS])
        wanted = profile(x_um, y_um[row : row + _ROWS])[:, inside].T * (weight * scale)
        if wanted.size:
            parts = np.concatenate([wanted.real, wanted.imag], axis=1).astype(np.float32)
            best = np.argmax(parts @ table - penalty, axis=1)
            index[row : row + _ROWS][inside] = best + 1
            got = jones[best] * weight
            common += float(np.sum(wanted.conj() * got).real)
            power, spent = power + float(np.sum(np.abs(wanted) ** 2)), spent + float(np.sum(np.abs(got) ** 2))
        progress("layout", min(row + _ROWS, y_um.size), y_um.size)
    table_of_all = np.concatenate([np.zeros((1, 3), dtype=np.complex128), jones])
    return TurnedPillars(lattice, index, kinds, table_of_all, common**2 / (power * spent))


def _scale(profile: StokesProfile, x_um: FloatArray, y_um: FloatArray, jones: ComplexArray) -> complex:
    """Amplitude and phase by which the target is nearest to what the pillars can do, on some of the sites."""
    step = max(1, math.isqrt(x_um.size * y_um.size // _PROBED_SITES))
    wanted = profile(x_um[::step], y_um[::step]).reshape(3, -1).T * np.array([1.0, math.sqrt(2.0), 1.0])
    have = jones * np.array([1.0, math.sqrt(2.0), 1.0])
    size = math.sqrt(float(np.mean(np.abs(have) ** 2) / np.mean(np.abs(wanted) ** 2)))
    penalty, best, found = 0.5 * np.sum(np.abs(have) ** 2, axis=1), -math.inf, 1.0 + 0.0j
    for share in (0.8, 1.0, 1.25, 1.6, 2.0):
        for turn in range(_PHASES):
            scale = share * size * np.exp(2j * np.pi * turn / _PHASES)
            score = (scale * wanted.conj() @ have.T).real - penalty
            chosen = have[np.argmax(score, axis=1)]
            # What arrives at the places is the square of what the pillars have in common with the target.
            common = abs(np.sum(wanted.conj() * chosen))
            if common > best:
                best, found = float(common), complex(scale.conjugate())
    return found
