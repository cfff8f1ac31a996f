"""Where the light of a device lands on the sensor plane, when a window misses it.

The field behind the pillars is cut into blocks. The Fourier transform of a block gives its plane waves; each of them is
a ray from the block to the sensor. Blocks of the side sqrt(wavelength x distance), a Fresnel zone, spread the light by
their side and by their diffraction alike, which is the resolution of the map. Bins of one beam land at one point: the
direction of each follows from its change of phase to the block shifted by one pillar (frequency reassignment, Auger and
Flandrin 1995).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from heapq import nlargest

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.layout.pillars import Lattice
from metafab.optics.geometry.imaging import Imaging, Tangent
from metafab.optics.geometry.path import Ray, path_um
from metafab.optics.point_spread import Psf
from metafab.optics.sources.source import Source

#: Share of the transmitted light in the window above which no other place is looked for.
_ENOUGH = 0.5
#: A place counts if it holds this many times the light of the window.
_BRIGHTER = 2.0
#: Fewest and most sites along a side of a block.
_FEWEST_SITES, _MOST_SITES = 16, 256
#: Most blocks that are transformed.
_MOST_BLOCKS = 4096
#: Cells of the map, in resolutions, and its reach in sensor distances: light beyond 84 degrees is left out.
_CELL, _REACH = 0.5, 10.0
#: Faintest plane wave that is placed, as a share of its block's brightest. The sum of many faint ones must not count as
#: a bright place.
_FAINTEST = 1e-3
#: Most cells of the map that are held, some 80 MB; beyond, the darker half is dropped.
_MOST_CELLS = 1 << 18
#: Number of columns between two rows in the number of a cell.
_ROW = 1 << 32

Places = tuple[tuple[float, float], tuple[float, float]]


def light_elsewhere(source: Source, imaging: Imaging, psf: Psf, tangent: Tangent = (0.0, 0.0)) -> Places | None:
    """Return (x, y) of the brightest place on the sensor for both polarisations, if a window misses the light.

    A window misses the light if it holds less than half of the transmitted light, and a place of its size outside it
    holds twice as much. The middle depth of the stack decides; ``tangent`` is the direction of its object.

    Returns:
        Places in um from the axis, to the resolution of the map or better; None if both windows hold their light.
    """
    middle, side_um = psf.depth_m.size // 2, psf.psf.shape[-1] * psf.pixel_um
    captured, transmitted = psf.efficiency[:, middle], np.array(psf.details.transmitted)
    if not transmitted.size or np.all(captured >= _ENOUGH * transmitted) or not transmitted.any():
        return None
    ray = Ray.towards_image(imaging, 0, float(psf.depth_m[middle]), tangent).in_air
    found = [_brightest(source, imaging, ray, p, side_um) for p in (0, 1)]
    missed = [
        share * transmitted[p] > _BRIGHTER * captured[p]
        and np.abs(np.subtract(place, psf.centre_um[p, middle])).max() > 0.5 * side_um
        for p, (place, share) in enumerate(found)
    ]
    return (found[0][0], found[1][0]) if any(missed) else None


def _brightest(
    source: Source, imaging: Imaging, ray: Ray, polarisation: int, side_um: float
) -> tuple[tuple[float, float], float]:
    """Centroid of the brightest square of the sensor, at least a window wide, and its share of the light."""
    resolution_um = math.sqrt(imaging.wavelength_um * imaging.sensor_distance_um)
    cell_um = _CELL * max(resolution_um, side_um)
    cells, total = dict[int, FloatArray](), 0.0
    for landed_x_um, landed_y_um, landed in _landings(source, imaging, ray, polarisation, resolution_um):
        total += float(landed.sum())
        bright = landed >= _FAINTEST * landed.max()
        x_um, y_um, power = landed_x_um[bright], landed_y_um[bright], landed[bright]
        column, row = (np.floor(at / cell_um).astype(np.int64) for at in (x_um, y_um))
        places, which = np.unique(row * _ROW + column, return_inverse=True)
        sums = np.stack([np.bincount(which, weights) for weights in (power, power * x_um, power * y_um)], axis=1)
        for key, part in zip(places.tolist(), sums, strict=True):
            cells[key] = cells.get(key, 0.0) + part
        if len(cells) > _MOST_CELLS:
            cells = dict(nlargest(_MOST_CELLS // 2, cells.items(), key=lambda cell: float(cell[1][0])))
    if not total:
        return (0.0, 0.0), 0.0
    none = np.zeros(3)

    def around(key: int) -> FloatArray:
        """Sum over the cell and its neighbours: one and a half windows, so that no light falls between two squares."""
        near = (key + down * _ROW + right for down in (-1, 0, 1) for right in (-1, 0, 1))
        return np.asarray(sum((cells.get(one, none) for one in near), none))

    brightest = max(sorted(cells), key=lambda key: float(cells[key][0]))
    power, x, y = around(brightest)
    return (float(x / power), float(y / power)), float(power / total)


def _landings(
    source: Source, imaging: Imaging, ray: Ray, polarisation: int, block_um: float
) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
    """Landing points and powers of the plane waves of one block after another."""
    lattice, k = source.lattice, imaging.wavenumber
    x_um, y_um = lattice.x_um(), lattice.y_um()
    pitch = [1e-3 * period * lattice.database_unit_nm for period in lattice.period_dbu]
    sites = int(np.clip(round(block_um / max(pitch)), _FEWEST_SITES, _MOST_SITES))
    every = max(1, math.isqrt(math.ceil(x_um.size * y_um.size / sites**2 / _MOST_BLOCKS)))
    for tile in source.tiles():
        amplitude = tile.amplitude(polarisation)
        for top, left in _corners(amplitude, sites, every):
            block = amplitude[top : top + sites, left : left + sites]
            if not block.any():
                continue
            x = x_um[tile.column + left : tile.column + left + block.shape[1]]
            y = y_um[tile.row + top : tile.row + top + block.shape[0]]
            # The incident wave: the path to the sensor point is the same for the whole wave and drops out.
            incident = np.exp(1j * k * _incident_um(x[None, :], y[:, None], ray))
            cosines, power = plane_waves(block * incident, sites, imaging.wavelength_um / np.array(pitch), lattice)
            along = np.sqrt(np.maximum(0.0, 1.0 - (cosines**2).sum(axis=0)))
            lit = along > 1.0 / _REACH
            if lit.any():
                shift_x, shift_y = imaging.sensor_distance_um * cosines[:, lit] / along[lit]
                yield x.mean() + shift_x, y.mean() + shift_y, power[lit]


def plane_waves(
    block: ComplexArray, sites: int, steepest: FloatArray, lattice: Lattice
) -> tuple[FloatArray, FloatArray]:
    """Direction cosines along x and y, shape (2, n, n), and powers, shape (n, n), of the plane waves of a block.

    ``steepest`` is the wavelength over the pitch along x and y, the cosine of a phase of 2 pi a site.
    """
    (rows, columns), pairs = lattice.reach, lattice.pairs[:2]
    # A single row has no step to the next one: it counts as even along y.
    least = 1 + rows, 1 + columns
    block = np.pad(block, [(0, max(0, n - count)) for n, count in zip(least, block.shape, strict=True)], mode="edge")
    n_y, n_x = block.shape[0] - rows, block.shape[1] - columns
    near = np.stack([block[down : down + n_y, right : right + n_x] for down, right in ((0, 0), *pairs)])
    # Sites without both neighbours are left out: the aperture's outline would count as a change of phase.
    here, *steps = np.fft.fft2(near * (near != 0.0).all(axis=0), (sites, sites))
    turns, scale = np.angle(np.array(steps) * here.conj()) / (2.0 * np.pi), steepest[:, None, None]
    if lattice.hexagonal:  # steps to the second site along x, and to the first along both
        turns[0] *= 0.5
        turns[1] -= turns[0]
        turns[1] -= np.rint(turns[1])
        # Half a turn along both axes changes nothing at the sites with pillars: of these two waves, the flatter one.
        other = turns - np.copysign(0.5, turns)
        turns = np.where(((scale * other) ** 2).sum(axis=0) < ((scale * turns) ** 2).sum(axis=0), other, turns)
    return scale * turns, np.abs(here) ** 2


def _corners(amplitude: NDArray[np.complexfloating], sites: int, every: int) -> list[tuple[int, int]]:
    """First row and column of every n-th block of a tile along both axes."""
    rows, columns = (range(0, count, every * sites) for count in amplitude.shape)
    return [(row, column) for row in rows for column in columns]


def _incident_um(x_um: FloatArray, y_um: FloatArray, ray: Ray) -> FloatArray:
    """Path from the object to the lens point, minus that to the centre."""
    whole, rest = ray.numbers, (0.0, 0.0, 0.0, *ray.target_um)
    return np.asarray(path_um(x_um, y_um, whole) - path_um(x_um, y_um, rest))
