"""Target phases -> sizes in one look: the best field overlap, precomputed over the (phi_x, phi_y) torus.

A size suits a pair of target phases as far as its field overlaps with the wanted one,
Re(t_x e^{-i phi_x}) + Re(t_y e^{-i phi_y}): this weighs phase errors and transmittance together, as the focus
does. For the vectors u = (Re t_x, Im t_x, Re t_y, Im t_y) and q = (cos phi_x, sin phi_x, cos phi_y, sin phi_y)
it is the inner product u.q, and because |q|^2 = 2 for every target, the largest inner product is the nearest
neighbour once u carries a fifth coordinate sqrt(max|u|^2 - |u|^2). So one k-d tree fills the table.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from metafab.cell import is_square
from metafab.core.conventions import ComplexArray, FloatArray, wrap_phase
from metafab.core.errors import Fault, InputError
from metafab.core.numeric.compiled import HAS_NUMBA, compiled
from metafab.core.parallel.executor import default_workers
from metafab.library.library import Library
from metafab.materials import refractive_index
from metafab.spec.cell import UnitCell

_LARGEST_INDEX = np.iinfo(np.uint16).max

# Rows of the table that are searched by all threads at once.
_ROWS_AT_ONCE = 64


@dataclass(frozen=True)
class SizeTable:
    """The sizes that a layout may use, and which of them suits a pair of target phases best.

    Attributes:
        database_unit_nm: size of one database unit (dbu).
        size_dbu: shape (n_sizes + 1, 2), (width, length), even whole numbers; row 0 is (0, 0), no pillar.
        t: shape (n_sizes + 1, 2), transmission of x and y polarised light at the design wavelength.
        error: shape (n_sizes + 1,), the library's bound on the absolute error of ``t``.
        size_index: shape (cells, cells), indexed [phi_y, phi_x]: the size with the best overlap at the phases
            2 pi (column, row) / cells.
        overlap: the same shape, the overlap reached there (2 for a perfect pillar with |t| = 1).
    """

    database_unit_nm: float
    size_dbu: NDArray[np.int32]
    t: ComplexArray
    error: FloatArray
    size_index: NDArray[np.uint16]
    overlap: FloatArray

    @property
    def cells(self) -> int:
        """Cells of the table along each phase, a power of two."""
        return int(self.size_index.shape[0])

    def sizes_for(self, phase_x_rad: ArrayLike, phase_y_rad: ArrayLike) -> NDArray[np.uint16]:
        """Size index of each pair of target phases; one look-up a pillar.

        Args:
            phase_x_rad: any shape, radians, need not be wrapped.
            phase_y_rad: a shape that broadcasts with it.

        Returns:
            The broadcast shape, indices into ``size_dbu``.
        """
        phase_x, phase_y = np.broadcast_arrays(phase_x_rad, phase_y_rad)
        if not HAS_NUMBA or phase_x.ndim == 0:
            return self.size_index[self._cell(phase_y), self._cell(phase_x)]
        wanted = [np.ascontiguousarray(phase, dtype=np.float64) for phase in (phase_x, phase_y)]
        sizes = np.empty(phase_x.shape, dtype=np.uint16)
        _look_up(wanted[0].ravel(), wanted[1].ravel(), self.size_index, sizes.ravel())
        return sizes

    def phase_error_rad(
        self, size_index: NDArray[np.uint16], phase_x_rad: ArrayLike, phase_y_rad: ArrayLike
    ) -> FloatArray:
        """Phase reached minus phase wanted: shape (2, ...) for x and y polarisation, wrapped to (-pi, pi]."""
        reached = np.angle(self.t)[size_index]
        wanted = np.asarray(phase_x_rad, dtype=np.float64), np.asarray(phase_y_rad, dtype=np.float64)
        return np.stack([wrap_phase(reached[..., axis] - phase) for axis, phase in enumerate(wanted)])

    def histogram(self, phase_x_rad: ArrayLike, phase_y_rad: ArrayLike) -> NDArray[np.int64]:
        """How many targets fall into each cell, indexed [phi_y, phi_x]; histograms of tiles add up."""
        flat = self._cell(phase_y_rad) * self.cells + self._cell(phase_x_rad)
        return np.bincount(flat.ravel(), minlength=self.cells**2).reshape(self.cells, self.cells)

    def _cell(self, phase_rad: ArrayLike) -> NDArray[np.int64]:
        """Nearest cell of a phase; the number of cells is a power of two, so a mask wraps the index."""
        scaled = np.multiply(phase_rad, self.cells / (2.0 * math.pi), dtype=np.float64)
        return np.rint(scaled).astype(np.int64) & (self.cells - 1)


@compiled
def _look_up(
    phase_x_rad: FloatArray, phase_y_rad: FloatArray, size_index: NDArray[np.uint16], out: NDArray[np.uint16]
) -> None:
    """Nearest cell of each pair, as :meth:`SizeTable.sizes_for` without numba finds it."""
    per_radian = len(size_index) / (2.0 * math.pi)
    wrap = len(size_index) - 1
    for i in range(out.size):
        row = np.int64(np.rint(phase_y_rad[i] * per_radian)) & wrap
        out[i] = size_index[row, np.int64(np.rint(phase_x_rad[i] * per_radian)) & wrap]


def build_size_table(
    library: Library,
    *,
    database_unit_nm: float,
    max_width_nm: float = math.inf,
    max_length_nm: float = math.inf,
    min_feature_nm: float = 0.0,
    cells: int = 512,
    cd_sigma_nm: float = 0.0,
    max_error: float = math.inf,
    isotropic: bool = False,
) -> SizeTable:
    """The mapping table of a library under a process' rules.

    Args:
        library: what the sizes do.
        database_unit_nm: unit of the mask; every admitted size must be an even number of units.
        max_width_nm: largest width, period minus smallest gap.
        max_length_nm: largest length, likewise.
        min_feature_nm: smallest width and length.
        cells: cells of the table along each phase, a power of two; 512 is a step of 0.012 rad.
        cd_sigma_nm: standard deviation of a bias that fabrication adds to width and length alike. The overlap
            is then the one expected under such a bias: t is damped by exp(-(cd_sigma d phi/d bias)^2 / 2), so
            sizes whose phase turns fast give way to calm ones. 0 maps to the nominal field.
        max_error: sizes whose stated error is larger are not used.
        isotropic: use only sizes that the lattice's symmetry makes answer both polarisations alike: pillars as wide as
            long, and every cross, in a square cell.

    Raises:
        InputError: no size is left, a size is not exact in database units, or there are more than 65535 sizes.
    """
    if cells < 2 or cells & (cells - 1):
        raise ValueError(f"`cells`: expected a power of two from 2, got {cells}")
    known = library.known & (library.error_of_sizes <= max_error)
    if isotropic:
        known = known & isotropic_sizes(library)
    row, column = _admitted(library, max_width_nm, max_length_nm, min_feature_nm, known)
    size_nm = np.stack([library.width_nm[column], library.length_nm[row]], axis=-1)
    size_dbu = _exact_dbu(size_nm, database_unit_nm)
    t_grid = np.stack([library.t_xx[0], library.t_yy[0]], axis=-1)
    t = t_grid[row, column]
    damping = np.exp(-0.5 * (cd_sigma_nm * phase_slope_per_nm(library)[row, column]) ** 2)
    size_index, overlap = best_overlap(t * damping, cells)
    return SizeTable(
        database_unit_nm=database_unit_nm,
        size_dbu=np.concatenate([np.zeros((1, 2), dtype=np.int32), size_dbu]),
        t=np.concatenate([empty_cell_t(library.unit_cell)[None], t]),
        error=np.concatenate([[0.0], library.error_of_sizes[row, column]]),
        size_index=size_index,
        overlap=overlap,
    )


def global_offsets(table: SizeTable, histogram: NDArray[np.int64]) -> tuple[float, float]:
    """Constant phases (c_x, c_y) to add to a design's targets for the largest total overlap.

    A constant phase of a whole lens changes nothing in its image, but moves the targets off the weak places of
    the library. For targets spread evenly over the torus every offset is as good; a lens' targets are not.

    Args:
        table: the sizes and their overlap.
        histogram: shape (cells, cells), how often each pair of targets occurs (:meth:`SizeTable.histogram`).

    Returns:
        Offsets in radians, multiples of 2 pi / cells, wrapped to (-pi, pi]; (0, 0) if no other is better.
    """
    if histogram.shape != table.overlap.shape:
        raise ValueError(f"`histogram`: expected shape {table.overlap.shape}, got {histogram.shape}")
    spectrum = np.conj(np.fft.rfft2(histogram.astype(np.float64))) * np.fft.rfft2(table.overlap)
    total = np.fft.irfft2(spectrum, s=histogram.shape)
    # Offsets that differ by rounding only are equal; the first of them is (0, 0).
    best = np.flatnonzero(total.ravel() >= total.max() - 1e-12 * np.abs(total).max())[0]
    row, column = divmod(int(best), table.cells)
    step = 2.0 * math.pi / table.cells
    return float(wrap_phase(column * step)), float(wrap_phase(row * step))


def isotropic_sizes(library: Library) -> NDArray[np.bool_]:
    """Which sizes answer both polarisations alike by symmetry; shape (n_length, n_width).

    Raises:
        InputError: the cell itself tells x from y, so that no size does.
    """
    unit_cell = library.unit_cell
    if not is_square(unit_cell):
        expected = "a square lattice on an isotropic substrate, of which a quarter turn makes the same"
        raise InputError.single("library", "cell.period_nm", expected, "one that tells x from y")
    alike = np.abs(library.length_nm[:, None] - library.width_nm[None, :]) < 1e-6
    return np.ones_like(alike) if unit_cell.cell.shape == "cross" else alike


def phase_slope_per_nm(library: Library) -> FloatArray:
    """How fast the phase turns when width and length grow together (a bias of the critical dimension).

    Returns:
        Shape (n_length, n_width, 2), rad per nm of bias, for x and y polarisation at the design wavelength.
    """
    slope = np.zeros((*library.t_xx.shape[1:], 2))
    for channel, t in enumerate((library.t_xx[0], library.t_yy[0])):
        if not library.known.all():  # circles, which grow along the diagonal
            across = t.diagonal()
            turned = np.diag(_turn(_gradient(across, library.width_nm, 0), across))
            slope[..., channel] = np.where(library.known, turned, np.nan)
            continue
        turning = np.zeros_like(t)
        for axis, size_nm in enumerate((library.length_nm, library.width_nm)):
            if size_nm.size > 1:
                turning += _gradient(t, size_nm, axis)
        slope[..., channel] = _turn(turning, t)
    return slope


def _turn(change: ComplexArray, t: ComplexArray) -> FloatArray:
    """Im(t' / t); where |t| vanishes the phase is undefined and the slope is left finite, but huge."""
    return np.asarray((change * np.conj(t)).imag / np.maximum(np.abs(t) ** 2, 1e-12))


def empty_cell_t(unit_cell: UnitCell) -> ComplexArray:
    """Transmission of a cell without a pillar: Fresnel's surface and a path of one pillar height in the ambient.

    Returns:
        Shape (2,), x and y polarisation.
    """
    light = unit_cell.illumination
    n_substrate = np.array(refractive_index(unit_cell.materials.substrate, light.wavelength_nm))
    n_ambient = np.array(refractive_index(unit_cell.materials.ambient, light.wavelength_nm))
    n_in, n_out = (n_substrate, n_ambient) if light.side == "substrate" else (n_ambient, n_substrate)
    path = 2.0 * math.pi * n_ambient * unit_cell.cell.height_nm / light.wavelength_nm
    return np.asarray(2.0 * n_in / (n_in + n_out) * np.exp(1j * path), dtype=np.complex128)


def _gradient(t: ComplexArray, size_nm: FloatArray, axis: int) -> ComplexArray:
    """Central differences along one axis, second order at its ends where there are three sizes."""
    order: Literal[1, 2] = 2 if size_nm.size > 2 else 1
    gradient: ComplexArray = np.gradient(t, size_nm, axis=axis, edge_order=order)
    return gradient


def _admitted(
    library: Library, max_width_nm: float, max_length_nm: float, min_feature_nm: float, usable: NDArray[np.bool_]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of the ``usable`` sizes that the rules leave; ``usable`` has shape (n_length, n_width)."""
    tolerance_nm = 1e-6
    smallest_nm = min_feature_nm - tolerance_nm
    width_fits = (library.width_nm >= smallest_nm) & (library.width_nm <= max_width_nm + tolerance_nm)
    length_fits = (library.length_nm >= smallest_nm) & (library.length_nm <= max_length_nm + tolerance_nm)
    if library.unit_cell.cell.shape == "cross":  # turned by 90 degrees it is the same one: either will do
        usable = usable & (library.width_nm >= library.length_nm[:, None])
    row, column = np.nonzero(length_fits[:, None] & width_fits[None, :] & usable)
    if not 0 < row.size <= _LARGEST_INDEX:
        got = (
            f"{row.size} of {usable.size} sizes within widths {min_feature_nm:g} to {max_width_nm:g} nm and lengths "
            f"{min_feature_nm:g} to {max_length_nm:g} nm, {int(np.count_nonzero(usable))} of all being known and "
            "symmetric enough"
        )
        remedy = "relax the rules or rebuild the library" if row.size == 0 else "use a coarser `sweep.size_grid_nm`"
        raise InputError.single("library", "sweep", f"1 to {_LARGEST_INDEX} sizes that the rules allow", got, remedy)
    return row, column


def _exact_dbu(size_nm: FloatArray, database_unit_nm: float) -> NDArray[np.int32]:
    """Sizes in database units, each even, so that a rectangle centred on a site has its edges on the grid."""
    halves = size_nm / (2.0 * database_unit_nm)
    off_grid = np.abs(halves - np.rint(halves)) > 1e-6
    if np.any(off_grid):
        faults = [
            Fault(
                f"mask.database_unit_nm (with {name})",
                f"a unit that divides half of every {name.removesuffix('_nm')}",
                f"{database_unit_nm:g} nm, which {int(np.count_nonzero(wrong))} sizes do not fit (such as "
                f"{values[wrong][0]:g} nm)",
                "use a smaller unit or another `sweep.size_grid_nm`; nothing is rounded silently",
            )
            for name, values, wrong in zip(("width_nm", "length_nm"), size_nm.T, off_grid.T, strict=True)
            if np.any(wrong)
        ]
        raise InputError("library", faults)
    return (2 * np.rint(halves)).astype(np.int32)


def best_overlap(t: ComplexArray, cells: int) -> tuple[NDArray[np.uint16], FloatArray]:
    """For every cell of the torus the row of ``t`` (counted from 1) with the largest overlap, and that overlap."""
    u = np.stack([t[:, 0].real, t[:, 0].imag, t[:, 1].real, t[:, 1].imag], axis=-1)
    power = np.sum(u**2, axis=-1)
    tree = cKDTree(np.concatenate([u, np.sqrt(power.max() - power)[:, None]], axis=-1))
    phase = 2.0 * math.pi * np.arange(cells) / cells
    cosine, sine = np.cos(phase), np.sin(phase)
    index = np.empty((cells, cells), dtype=np.uint16)
    overlap = np.empty((cells, cells))
    for rows in np.array_split(np.arange(cells), -(-cells // _ROWS_AT_ONCE)):
        wanted = np.broadcast_arrays(cosine, sine, cosine[rows, None], sine[rows, None])
        _, best = tree.query(np.stack([*wanted, np.zeros((rows.size, cells))], axis=-1), workers=default_workers())
        index[rows] = best + 1
        overlap[rows] = sum(u[best, axis] * part for axis, part in enumerate(wanted))
    return index, overlap
