"""Amplitudes of the pillars of a lens for any bias and wall angle, and the light that its written sizes send.

The light of a mask is the target wave times c, plus a rest that hardly enters the pinhole: c is the mean over all sites
of the pillars' amplitude times the conjugate target wave. Sums of the target wave over the sites of each size turn this
into a sum over a few thousand sizes, so that any bias takes a millisecond.
"""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import RectBivariateSpline

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.storage.files import whole_file
from metafab.layout.pillars import PillarMap
from metafab.library.axes import Corner, corner_cell
from metafab.library.use.amplitudes import half_space_indices
from metafab.library.use.any_size import solved_amplitudes
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Design, UnitCell

#: Wall angles, degrees, of walls that slope and are otherwise as drawn at half height. At 84 degrees pillars of 70 nm
#: end in a ridge of 7 nm, and those of 280 nm leave 7 nm between their feet.
WALLS_DEG = np.arange(84.0, 90.1, 2.0)
#: Sizes that are solved, nm, and those of the tables: mask sizes, biased by up to 30 nm.
_SOLVED_NM, TABLE_NM = np.arange(70.0, 282.1, 4.0), np.arange(70.0, 280.1, 2.0)
#: Slices of a sloped wall.
SLICES = 8


@dataclass(frozen=True)
class SizeSums:
    """Sums over the sites of each pillar size, which give the light in the target wave."""

    width_nm: FloatArray  #: Shape (n,), distinct sizes.
    length_nm: FloatArray  #: Shape (n,).
    count: FloatArray  #: Shape (n,), pillars of each size over the number of sites inside the aperture.
    wanted: ComplexArray  #: Shape (n, 2), mean over all sites of the conjugate target wave on the sites of each size.

    @classmethod
    def of(cls, pillars: PillarMap, profile: PhaseProfile, design: Design) -> SizeSums:
        """Add up the sites of a mask, tile by tile."""
        sizes = pillars.size_nm()
        count = np.zeros(len(sizes))
        real, imag = np.zeros((2, len(sizes), 2))
        sites, x, y = 0, pillars.lattice.x_um(), pillars.lattice.y_um()
        for tile in pillars.tiles():
            n_y, n_x = tile.size_index.shape
            columns, rows = x[tile.column : tile.column + n_x], y[tile.row : tile.row + n_y]
            sites += int(design.device.encloses(columns, rows).sum())
            index, target_rad = tile.size_index.ravel(), profile(columns, rows)
            count += np.bincount(index, minlength=len(sizes))
            for p in (0, 1):
                real[:, p] += np.bincount(index, np.cos(target_rad[p]).ravel(), len(sizes))
                imag[:, p] -= np.bincount(index, np.sin(target_rad[p]).ravel(), len(sizes))
        wanted = (real + 1j * imag) / sites
        return cls(sizes[1:, 0], sizes[1:, 1], count[1:] / sites, wanted[1:])


@dataclass(frozen=True)
class Sizes:
    """Amplitudes of all sizes that a bias reaches."""

    t: ComplexArray  #: Shape (n_length, n_width, 2), per square root of the flux, on the grid of the table.

    @classmethod
    def solved(
        cls,
        cell: UnitCell,
        wall_deg: float,
        folder: Path,
        executor: Executor | None = None,
        slices: int = SLICES,
        changed: Corner | None = None,
    ) -> Sizes:
        """Solve a cell with walls of one angle for every fourth nanometre of both sides; kept in ``folder``.

        The cell is square: of a size and its mirror image, one is solved. Between the sizes, splines of third order.
        ``changed`` are further values of the cell, such as its height.
        """
        corner = dict(changed or {})
        path = folder / "_".join([f"walls_{wall_deg:g}_{slices}", *(f"{n}_{v:g}" for n, v in corner.items())])
        path = path.with_name(path.name + ".npy")
        if not path.is_file():
            low, high = np.triu_indices(_SOLVED_NM.size)
            corner |= {"sidewall_angle_deg": wall_deg} if wall_deg < 90.0 else {}
            tasks = [
                (corner_cell(cell, width, length, corner), slices)
                for width, length in zip(_SOLVED_NM[low].tolist(), _SOLVED_NM[high].tolist(), strict=True)
            ]
            found = solved_amplitudes(tasks, executor)
            table = np.empty((_SOLVED_NM.size, _SOLVED_NM.size, 2), dtype=np.complex128)
            table[low, high], table[high, low] = found[:, ::-1], found  # Rows are lengths.
            folder.mkdir(parents=True, exist_ok=True)
            with whole_file(path) as part, part.open("wb") as stream:
                np.save(stream, table)
        table = np.load(path)
        n_in, n_out = half_space_indices(cell)
        flux = np.sqrt(n_out.real / n_in.real)
        between = [
            RectBivariateSpline(_SOLVED_NM, _SOLVED_NM, part)(TABLE_NM, TABLE_NM)
            for p in (0, 1)
            for part in (table[..., p].real, table[..., p].imag)
        ]
        t = np.stack([between[0] + 1j * between[1], between[2] + 1j * between[3]], axis=-1)
        return cls(t * flux)

    def at(self, width_nm: FloatArray, length_nm: FloatArray) -> ComplexArray:
        """Amplitudes of sizes on the table's grid (those beyond its ends take its ends), shape (n, 2)."""
        step = float(TABLE_NM[1] - TABLE_NM[0])
        places = [np.rint((side - TABLE_NM[0]) / step).astype(int) for side in (length_nm, width_nm)]
        row, column = (np.clip(place, 0, TABLE_NM.size - 1) for place in places)
        return np.asarray(self.t[row, column])
