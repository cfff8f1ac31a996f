"""Sizes for target phases by the largest field overlap, precomputed over the (phi_x, phi_y) torus.

The overlap of a size with a pair of target phases is Re(t_x e^{-i phi_x}) + Re(t_y e^{-i phi_y}). It combines phase
error and transmittance, as the field at the focus does. It is the inner product u.q of two vectors, u = (Re t_x,
Im t_x, Re t_y, Im t_y) and q = (cos phi_x, sin phi_x, cos phi_y, sin phi_y). Because |q|^2 = 2 for every target, the
largest inner product is the nearest neighbour once u has the fifth coordinate sqrt(max|u|^2 - |u|^2). One k-d tree
fills the table.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from metafab.cell import is_square
from metafab.core.conventions import ComplexArray, FloatArray, wrap_phase
from metafab.core.errors import Fault, InputError
from metafab.core.numeric.compiled import compiled
from metafab.core.parallel.executor import default_workers
from metafab.core.parallel.interrupts import held_interrupts
from metafab.library.library import Library
from metafab.library.use.amplitudes import empty_cell_t

_LARGEST_INDEX = np.iinfo(np.uint16).max

#: Least factor of the overlap of a size whose t is not known.
_LEAST_TRUST = 1e-3

#: Distance of an edge from the grid, in database units, beyond which it is not rounding of decimal sizes.
_OFF_GRID_UNITS = 1e-6

#: Rows of the table per query of the k-d tree.
_ROWS_AT_ONCE = 64


@dataclass(frozen=True)
class SizeTable:
    """The sizes that a layout may use, and the best of them for every pair of target phases."""

    database_unit_nm: float  #: Size of one database unit (dbu).
    #: Shape (n_sizes + 1, 2), (width, length), even whole numbers; row 0 is (0, 0), no pillar.
    size_dbu: NDArray[np.int32]
    t: ComplexArray  #: Shape (n_sizes + 1, 2), transmission of x and y polarised light at the design wavelength.
    error: FloatArray  #: Shape (n_sizes + 1,), the library's bound on the absolute error of ``t``.
    #: Shape (cells, cells), indexed [phi_y, phi_x]: the size with the best overlap at the phases 2 pi (column, row) /
    #: cells.
    size_index: NDArray[np.uint16]
    overlap: FloatArray  #: Shape (cells, cells), the best overlap (2 for a perfect pillar with |t| = 1).

    @property
    def cells(self) -> int:
        """Number of cells of the table along each phase, a power of two."""
        return int(self.size_index.shape[0])

    def sizes_for(self, phase_x_rad: ArrayLike, phase_y_rad: ArrayLike) -> NDArray[np.uint16]:
        """Return the size index of each pair of target phases (rad, any shapes that broadcast, wrapped or not)."""
        phases = np.broadcast_arrays(phase_x_rad, phase_y_rad)
        phase_x, phase_y = (np.ascontiguousarray(phase, dtype=np.float64).ravel() for phase in phases)
        sizes = np.empty(phases[0].shape, dtype=np.uint16)
        _look_up(phase_x, phase_y, self.size_index, sizes.reshape(-1))
        return sizes

    def shifted(self, shift_rad: FloatArray) -> SizeTable:
        """Return the table that finds at each pair of phases the size of this one at the phases plus ``shift_rad``.

        Shifts have the shape (2, cells, cells), of phi_x and phi_y, indexed [phi_y, phi_x].
        """
        phase = 2.0 * math.pi * np.arange(self.cells) / self.cells
        return replace(self, size_index=self.sizes_for(phase + shift_rad[0], phase[:, None] + shift_rad[1]))

    def histogram(self, phase_x_rad: ArrayLike, phase_y_rad: ArrayLike) -> NDArray[np.int64]:
        """Count the targets (rad, any shape) in each cell: shape (cells, cells), indexed [phi_y, phi_x]."""
        flat = self.nearest_cell(phase_y_rad) * self.cells + self.nearest_cell(phase_x_rad)
        return np.bincount(flat.ravel(), minlength=self.cells**2).reshape(self.cells, self.cells)

    def nearest_cell(self, phase_rad: ArrayLike) -> NDArray[np.int64]:
        """Return the row or column of the table nearest to a phase, 0 to cells - 1, for phases of any shape."""
        scaled = np.multiply(phase_rad, self.cells / (2.0 * math.pi), dtype=np.float64)
        # The number of cells is a power of two, so that a mask wraps the index.
        return np.rint(scaled).astype(np.int64) & (self.cells - 1)


@compiled
def _look_up(
    phase_x_rad: FloatArray, phase_y_rad: FloatArray, size_index: NDArray[np.uint16], out: NDArray[np.uint16]
) -> None:
    """Write the size index at the nearest cell of each pair to ``out``, as :meth:`SizeTable.nearest_cell` finds it."""
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
    """Return the table of the best sizes under a process' rules.

    Args:
        database_unit_nm: unit of the mask; every admitted size must be an even number of units.
        max_width_nm: largest width, period minus smallest gap; likewise ``max_length_nm``.
        min_feature_nm: smallest width and length.
        cells: cells of the table along each phase, a power of two; 512 is a step of 0.012 rad.
        cd_sigma_nm: standard deviation of a bias that fabrication adds to width and length alike. The overlap is then
            its expectation over the bias: t is damped by exp(-(cd_sigma d phi/d bias)^2 / 2), which favours sizes whose
            phase changes slowly. 0 maps to the nominal field.
        max_error: largest error bound of an admitted size.
        isotropic: admit only sizes whose response is equal for both polarisations by symmetry
            (:func:`isotropic_sizes`).

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
    t = library.t[row, column]
    error = library.error_of_sizes[row, column]
    damping = np.exp(-0.5 * (cd_sigma_nm * phase_slope_per_nm(library)[row, column]) ** 2)
    damping *= trust(t, error, library.unit_cell.sweep.target_error)
    size_index, overlap = best_overlap(t * damping, cells)
    return SizeTable(
        database_unit_nm=database_unit_nm,
        size_dbu=np.concatenate([np.zeros((1, 2), dtype=np.int32), size_dbu]),
        t=np.concatenate([empty_cell_t(library.unit_cell)[None], t]),
        error=np.concatenate([[0.0], error]),
        size_index=size_index,
        overlap=overlap,
    )


def trust(t: ComplexArray, error: FloatArray, target_error: float) -> FloatArray:
    """Return the factor of the overlap of each size: the share of t that its error bound leaves.

    The factor is 1 for sizes within the target error. ``t`` and the result have the shape (n_sizes, 2), error bounds
    (n_sizes,).
    """
    left = np.maximum(1.0 - error[:, None] / np.maximum(np.abs(t), 1e-12), _LEAST_TRUST)
    return np.where(error[:, None] > target_error, left, 1.0)


def global_offsets(
    table: SizeTable, histogram: NDArray[np.int64], *, keep_retardance: bool = False
) -> tuple[float, float]:
    """Return constant phases (c_x, c_y) that, added to a design's target phases, give the largest total overlap.

    A constant phase of a whole lens does not change its image, but moves the targets away from pairs of phases that no
    size reaches. For targets spread evenly over the torus all offsets are equal, and (0, 0) is returned.

    The number of targets in each cell, shape (cells, cells), is that of :meth:`SizeTable.histogram`. Offsets are
    multiples of 2 pi / cells, wrapped to (-pi, pi]; with ``keep_retardance``, c_x = c_y.
    """
    if histogram.shape != table.overlap.shape:
        raise ValueError(f"`histogram`: expected shape {table.overlap.shape}, got {histogram.shape}")
    spectrum = np.conj(np.fft.rfft2(histogram.astype(np.float64))) * np.fft.rfft2(table.overlap)
    total = np.fft.irfft2(spectrum, s=histogram.shape)
    rounding = 1e-12 * np.abs(total).max()
    if keep_retardance:
        total = np.where(np.eye(table.cells, dtype=np.bool_), total, -np.inf)
    # Totals that differ by rounding only are equal; the first of them belongs to (0, 0).
    best = np.flatnonzero(total.ravel() >= total.max() - rounding)[0]
    row, column = divmod(int(best), table.cells)
    step = 2.0 * math.pi / table.cells
    return float(wrap_phase(column * step)), float(wrap_phase(row * step))


def isotropic_sizes(library: Library) -> NDArray[np.bool_]:
    """Return the mask of sizes with t_xx = t_yy by symmetry: squares and all crosses, shape (n_length, n_width).

    A cell without such a symmetry raises InputError.
    """
    unit_cell = library.unit_cell
    if not is_square(unit_cell):
        expected = "a square lattice on an isotropic substrate, unchanged by a quarter turn"
        raise InputError.single("library", "cell.period_nm", expected, "different responses along x and y")
    square = np.abs(library.length_nm[:, None] - library.width_nm[None, :]) < 1e-6
    return np.ones_like(square) if unit_cell.cell.shape == "cross" else square


def phase_slope_per_nm(library: Library) -> FloatArray:
    """Return the change of phase per nm when width and length grow together (a bias of the critical dimension).

    Where |t| vanishes the phase is undefined; the slope is then finite but huge. Its shape is (n_length, n_width, 2),
    rad per nm, for x and y polarisation at the design wavelength.
    """
    slope = np.zeros(library.t.shape)
    off_diagonal = library.width_nm != library.length_nm[:, None]
    is_diagonal = not library.known.all() and not library.known[off_diagonal].any()
    for channel, t in enumerate((library.t_xx[0], library.t_yy[0])):
        if is_diagonal:  # circles, or squares alone
            along = t.diagonal()
            turned = np.diag(_phase_change(_gradient(along, library.width_nm, 0), along))
            slope[..., channel] = np.where(library.known, turned, np.nan)
            continue
        change = np.zeros_like(t)
        for axis, size_nm in enumerate((library.length_nm, library.width_nm)):
            if size_nm.size > 1:
                change += _gradient(t, size_nm, axis)
        slope[..., channel] = _phase_change(change, t)
    return slope


def _phase_change(change: ComplexArray, t: ComplexArray) -> FloatArray:
    """Im(t' / t)."""
    return np.asarray((change * np.conj(t)).imag / np.maximum(np.abs(t) ** 2, 1e-12))


def _gradient(t: ComplexArray, size_nm: FloatArray, axis: int) -> ComplexArray:
    """Central differences along one axis, second order at its ends where there are three sizes.

    Beside a size without amplitude (NaN) they are one-sided, and 0 between two of them.
    """
    order: Literal[1, 2] = 2 if size_nm.size > 2 else 1
    gradient: ComplexArray = np.gradient(t, size_nm, axis=axis, edge_order=order)
    if np.isfinite(gradient).all():
        return gradient
    steps = np.diff(t, axis=axis) / np.expand_dims(np.diff(size_nm), 1 - axis)
    for after in (1, 0):
        ends = [(0, 0)] * t.ndim
        ends[axis] = (1 - after, after)
        one_sided = np.pad(steps, ends, constant_values=np.nan)
        gradient = np.where(np.isfinite(gradient), gradient, one_sided)
    return np.where(np.isfinite(gradient), gradient, 0.0)


def _admitted(
    library: Library, max_width_nm: float, max_length_nm: float, min_feature_nm: float, usable: NDArray[np.bool_]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of the ``usable`` sizes, shape (n_length, n_width), that the rules admit."""
    tolerance_nm = 1e-6
    smallest_nm = min_feature_nm - tolerance_nm
    width_fits = (library.width_nm >= smallest_nm) & (library.width_nm <= max_width_nm + tolerance_nm)
    length_fits = (library.length_nm >= smallest_nm) & (library.length_nm <= max_length_nm + tolerance_nm)
    if library.unit_cell.cell.shape == "cross":  # (W, L) and (L, W) are one cross
        usable = usable & (library.width_nm >= library.length_nm[:, None])
    row, column = np.nonzero(length_fits[:, None] & width_fits[None, :] & usable)
    if not 0 < row.size <= _LARGEST_INDEX:
        got = (
            f"{row.size} of {usable.size} sizes within widths {min_feature_nm:g} to {max_width_nm:g} nm and lengths "
            f"{min_feature_nm:g} to {max_length_nm:g} nm; {int(np.count_nonzero(usable))} sizes meet the limits "
            "on error and symmetry"
        )
        remedy = "relax the rules or rebuild the library" if row.size == 0 else "use a coarser `sweep.size_grid_nm`"
        raise InputError.single("library", "sweep", f"1 to {_LARGEST_INDEX} sizes that the rules allow", got, remedy)
    return row, column


def fault_of_unit(sides_nm: FloatArray, database_unit_nm: float) -> Fault | None:
    """Fault of a database unit that does not divide half of every width and length, ``sides_nm``, of any shape.

    Rectangles centred on a site would have edges off the grid.
    """
    if not database_unit_nm > 0.0:
        return Fault("mask.database_unit_nm", "a length above 0", f"{database_unit_nm:g} nm")
    halves = sides_nm / (2.0 * database_unit_nm)
    is_off = np.abs(halves - np.rint(halves)) > _OFF_GRID_UNITS
    if not is_off.any():
        return None
    expected = f"a unit that divides half of every width and length of the library, such as {sides_nm[is_off][0]:g} nm"
    remedy = "use a smaller unit or another `sweep.size_grid_nm`; nothing is rounded silently"
    return Fault("mask.database_unit_nm", expected, f"{database_unit_nm:g} nm", remedy)


def _exact_dbu(size_nm: FloatArray, database_unit_nm: float) -> NDArray[np.int32]:
    """Sizes in even database units: the same shape; InputError for :func:`fault_of_unit`."""
    if (fault := fault_of_unit(size_nm, database_unit_nm)) is not None:
        raise InputError("library", [fault])
    return (2 * np.rint(size_nm / (2.0 * database_unit_nm))).astype(np.int32)


def best_overlap(t: ComplexArray, cells: int) -> tuple[NDArray[np.uint16], FloatArray]:
    """Find the size with the largest field overlap for every cell of the (phi_x, phi_y) torus.

    ``t``, shape (n_sizes, 2), is the transmission of x and y polarised light. Row of ``t``, counted from 1, and overlap
    have the shape (cells, cells), indexed [phi_y, phi_x].
    """
    u = np.stack([t[:, 0].real, t[:, 0].imag, t[:, 1].real, t[:, 1].imag], axis=-1)
    power = np.sum(u**2, axis=-1)
    tree = cKDTree(np.concatenate([u, np.sqrt(power.max() - power)[:, None]], axis=-1))
    phase = 2.0 * math.pi * np.arange(cells) / cells
    cosine, sine = np.cos(phase), np.sin(phase)
    index = np.empty((cells, cells), dtype=np.uint16)
    overlap = np.empty((cells, cells))
    for rows in np.array_split(np.arange(cells), -(-cells // _ROWS_AT_ONCE)):
        targets = np.broadcast_arrays(cosine, sine, cosine[rows, None], sine[rows, None])
        places = np.stack([*targets, np.zeros((rows.size, cells))], axis=-1)
        with held_interrupts():  # SciPy's threads would read the tree while the interrupt ends it.
            _, best = tree.query(places, workers=default_workers())
        index[rows] = best + 1
        overlap[rows] = sum(u[best, axis] * part for axis, part in enumerate(targets))
    return index, overlap
