"""From block sums to the field on one window of the sensor: a few matrix Fourier transforms.

The kernel h(R) exp(ikR) from a lens point (x, y) to a window point (u, v) is, up to a phase on the window alone,

    exp(ik R(x, y; 0, 0)) x exp(ik X(x, u)) x exp(ik Y(y, v)) x (smooth rest).

The first factor belongs to the pupil's path. X and Y are the exact change of distance along the axes; being
functions of one lens and one window coordinate they are the two matrices of a separable transform. The rest
(curvature and skew off the axes, obliquity, fall-off with distance) has low rank: it is sampled on Chebyshev
points and split by a singular value decomposition, sum over m of A_m(u, v) B_m(x, y).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.numerics import HAS_NUMBA, compiled
from metafab.optics import chebyshev
from metafab.optics.chebyshev import Span
from metafab.optics.path import Ray, incident_amplitude, path_and_slopes
from metafab.optics.pupil import Pupil

#: Block phases are reduced in double precision; what is left fits single precision: 1e-6 of the field at most.
SingleComplexArray = NDArray[np.complex64]


@dataclass(frozen=True)
class WindowKernel:
    """Propagation from Chebyshev points of the lens to one window, whatever the blocks are.

    Attributes:
        wavenumber: k, rad/um; that of the blocks, or another wavelength's.
        target_um: (x, y, z) of the window's centre point.
        offsets_um: shape (n,), window points along x and y from the centre.
        lens_um: ((lowest, highest) x, (lowest, highest) y) of the lens points.
        left: shape (n, q_y), exp(ik Y).
        right: shape (q_x, n), exp(ik X).
        over_window: shape (rank, n, n), A_m.
        over_lens: shape (rank, q_y, q_x), B_m.
    """

    wavenumber: float
    target_um: tuple[float, float, float]
    offsets_um: FloatArray
    lens_um: tuple[Span, Span]
    left: SingleComplexArray
    right: SingleComplexArray
    over_window: SingleComplexArray
    over_lens: SingleComplexArray

    @classmethod
    def build(
        cls,
        wavenumber: float,
        target_um: tuple[float, float, float],
        lens_um: tuple[Span, Span],
        window_px: int,
        pixel_um: float,
        tolerance: float,
    ) -> WindowKernel:
        """Sample and split the kernel.

        Args:
            wavenumber: k, rad/um.
            target_um: centre of the window, which is point ``window_px // 2`` along either side.
            lens_um: box that holds all block centres.
            window_px: points a side.
            pixel_um: distance of points.
            tolerance: relative error, 1e-7 or more.
        """
        k = wavenumber
        offsets = np.multiply(np.arange(window_px) - window_px // 2, pixel_um, dtype=np.float64)
        span = (float(offsets[0]), float(offsets[-1]))
        corners = np.array(np.meshgrid(*lens_um, span, span, indexing="ij")).reshape(4, -1)
        changes_rad = k * np.abs(_changes_um(target_um, *corners)).max(axis=1)
        x, y = (
            chebyshev.points(s, chebyshev.points_needed(c, tolerance))
            for s, c in zip(lens_um, changes_rad[:2], strict=True)
        )
        over_window, over_lens = _split_rest(k, target_um, lens_um, span, float(changes_rad[2]), tolerance)
        to_window = chebyshev.interpolation(span, over_window.shape[1], offsets)
        to_x, to_y = (chebyshev.interpolation(s, over_lens.shape[1], at) for s, at in zip(lens_um, (x, y), strict=True))
        along_x, _, _ = _changes_um(target_um, x[:, None], 0.0, offsets[None, :], 0.0)
        _, along_y, _ = _changes_um(target_um, 0.0, y[None, :], 0.0, offsets[:, None])
        return cls(
            k,
            target_um,
            offsets,
            lens_um,
            np.exp(1j * k * along_y).astype(np.complex64),
            np.exp(1j * k * along_x).astype(np.complex64),
            (to_window @ over_window @ to_window.T).astype(np.complex64),
            (to_y @ over_lens @ to_x.T).astype(np.complex64),
        )

    @property
    def rank(self) -> int:
        """Terms of the low-rank part."""
        return int(self.over_window.shape[0])


@dataclass(frozen=True)
class WindowTransform:
    """The linear map from refocused blocks to the field on the window.

    Attributes:
        kernel: from Chebyshev points to the window.
        gather_y: shape (q_y, n_y), transposed interpolation: blocks to weights on Chebyshev points.
        gather_x: shape (n_x, q_x).
        by_order: shape (3, n, n) or (1, n, n), what a window point makes of a block's sum and moments: the
            diffraction of a block, and i times its phase slope along x and y. Blocks of one site have no moments.
    """

    kernel: WindowKernel
    gather_y: NDArray[np.float32]
    gather_x: NDArray[np.float32]
    by_order: SingleComplexArray

    @classmethod
    def build(cls, pupil: Pupil, kernel: WindowKernel) -> WindowTransform:
        """The transform from the blocks of ``pupil`` to the window of ``kernel``."""
        q_y, q_x = kernel.over_lens.shape[1:]
        (x, y, z), block, n = kernel.target_um, pupil.carrier.block_sites, kernel.offsets_um.size
        distance = math.hypot(x, y, z)
        slope_x, slope_y = (
            -kernel.wavenumber * (1.0 - (c / distance) ** 2) / distance * kernel.offsets_um for c in (x, y)
        )
        diffraction = np.outer(
            _dirichlet(slope_y * pupil.pitch_um[1], block), _dirichlet(slope_x * pupil.pitch_um[0], block)
        )
        orders = [diffraction, 1j * np.tile(slope_x, (n, 1)), 1j * np.tile(slope_y, (n, 1)).T]
        return cls(
            kernel,
            chebyshev.interpolation(kernel.lens_um[1], q_y, pupil.y_um).T.astype(np.float32, order="C"),
            chebyshev.interpolation(kernel.lens_um[0], q_x, pupil.x_um).astype(np.float32, order="C"),
            np.array(orders[: 1 if block == 1 else 3], dtype=np.complex64),
        )

    def field(self, blocks: SingleComplexArray) -> SingleComplexArray:
        """Field on the window, shape (n, n), of refocused blocks of shape (1 or 3, n_y, n_x)."""
        kernel = self.kernel
        rows = (self.gather_y @ blocks.view(np.float32)).view(np.complex64)
        weights = (rows.real @ self.gather_x) + 1j * (rows.imag @ self.gather_x)
        total = np.zeros(self.by_order.shape[1:], dtype=np.complex64)
        for terms, order, weight in zip(self._terms(), self.by_order, weights, strict=True):
            images = kernel.left @ (kernel.over_lens[terms] * weight) @ kernel.right
            total += order * np.einsum("mvu,mvu->vu", kernel.over_window[terms], images)
        return total

    def _terms(self) -> list[slice]:
        """Low-rank terms for sum and moments: terms grow in strength, and moments, small, need the stronger half."""
        return [slice(None), *2 * [slice(self.kernel.rank // 2, None)]][: self.by_order.shape[0]]

    def adjoint(self, field: SingleComplexArray) -> SingleComplexArray:
        """Blocks, shape (1 or 3, n_y, n_x), of a window field: the conjugate transpose of :meth:`field`."""
        kernel = self.kernel
        blocks = []
        for terms, order in zip(self._terms(), self.by_order, strict=True):
            images = kernel.over_window[terms].conj() * (order.conj() * field)
            weights = kernel.left.conj().T @ images @ kernel.right.conj().T
            total = np.einsum("mvu,mvu->vu", kernel.over_lens[terms].conj(), weights)
            blocks.append(self.gather_y.T @ total @ self.gather_x.T)
        return np.array(blocks, dtype=np.complex64)


def refocus(pupil: Pupil, ray: Ray, wavenumber: float) -> SingleComplexArray:
    """Sums and moments behind another ray than the carrier: its path instead, and its incident amplitude.

    The change of phase is followed to second order in the block's size. ``wavenumber`` is the ray's, rad/um.

    Returns:
        Shape (3, n_y, n_x), or (1, n_y, n_x) for blocks of one site.
    """
    block = pupil.carrier.block_sites
    orders = 1 if block == 1 else 3
    # The mean of x^2 over a full block.
    spread_x, spread_y = (pitch * pitch * (block * block - 1) / 12.0 for pitch in pupil.pitch_um)
    kernel = _refocus_compiled if HAS_NUMBA else _refocus_plain
    old, blocks = pupil.carrier.ray, np.empty((orders, *pupil.power.shape), dtype=np.complex64)
    kernel(
        blocks, pupil.sums, pupil.x_um, pupil.y_um, wavenumber, pupil.wavenumber, spread_x, spread_y,
        ray.vergence_per_um, *ray.tangent, *ray.target_um, old.vergence_per_um, *old.tangent, *old.target_um,
    )  # fmt: skip
    return blocks


def _refocus_plain(
    blocks: Any, sums: Any, x: Any, y: Any, k: float, old_k: float, spread_x: float, spread_y: float,
    w: float, t_x: float, t_y: float, c_x: float, c_y: float, c_z: float,
    old_w: float, old_t_x: float, old_t_y: float, old_x: float, old_y: float, old_z: float,
) -> None:  # fmt: skip
    x, y = x[None, :], y[:, None]
    path, along_x, along_y = path_and_slopes(x, y, w, t_x, t_y, c_x, c_y, c_z)
    old_path, old_along_x, old_along_y = path_and_slopes(x, y, old_w, old_t_x, old_t_y, old_x, old_y, old_z)
    slope_x, slope_y = k * along_x - old_k * old_along_x, k * along_y - old_k * old_along_y
    wave = np.exp(1j * (k * path - old_k * old_path)) * incident_amplitude(x, y, w, t_x, t_y)
    second = 1.0 - 0.5 * (slope_x**2 * spread_x + slope_y**2 * spread_y)
    blocks[0] = wave * (second * sums[0] + 1j * (slope_x * sums[1] + slope_y * sums[2]))
    if blocks.shape[0] == 3:
        blocks[1] = wave * (sums[1] + 1j * slope_x * spread_x * sums[0])
        blocks[2] = wave * (sums[2] + 1j * slope_y * spread_y * sums[0])


@compiled
def _refocus_compiled(
    blocks: Any, sums: Any, x: Any, y: Any, k: float, old_k: float, spread_x: float, spread_y: float,
    w: float, t_x: float, t_y: float, c_x: float, c_y: float, c_z: float,
    old_w: float, old_t_x: float, old_t_y: float, old_x: float, old_y: float, old_z: float,
) -> None:  # fmt: skip
    blocks[:] = 0.0
    for i in range(y.size):
        for j in range(x.size):
            if sums[0, i, j] == 0.0:
                continue
            path, along_x, along_y = path_and_slopes(x[j], y[i], w, t_x, t_y, c_x, c_y, c_z)
            old = path_and_slopes(x[j], y[i], old_w, old_t_x, old_t_y, old_x, old_y, old_z)
            phase = k * path - old_k * old[0]
            slope_x, slope_y = k * along_x - old_k * old[1], k * along_y - old_k * old[2]
            amplitude = incident_amplitude(x[j], y[i], w, t_x, t_y)
            wave = amplitude * math.cos(phase) + 1j * (amplitude * math.sin(phase))
            s, s_x, s_y = sums[0, i, j], sums[1, i, j], sums[2, i, j]
            second = 1.0 - 0.5 * (slope_x * slope_x * spread_x + slope_y * slope_y * spread_y)
            blocks[0, i, j] = wave * (second * s + 1j * (slope_x * s_x + slope_y * s_y))
            if blocks.shape[0] == 3:
                blocks[1, i, j] = wave * (s_x + 1j * slope_x * spread_x * s)
                blocks[2, i, j] = wave * (s_y + 1j * slope_y * spread_y * s)


def _dirichlet(phase_per_site: FloatArray, sites: int) -> FloatArray:
    """Mean of exp(i phase n) over a centred run of ``sites``: the diffraction of a block, 1 for one site."""
    half = 0.5 * phase_per_site
    steep = np.abs(np.sin(half)) > 1e-9
    safe = np.where(steep, half, 1.0)
    return np.where(steep, np.sin(sites * safe) / (sites * np.sin(safe)), 1.0)


def _split_rest(
    k: float,
    target_um: tuple[float, float, float],
    lens_um: tuple[Span, Span],
    window_um: Span,
    rest_rad: float,
    tolerance: float,
) -> tuple[ComplexArray, ComplexArray]:
    """A_m and B_m, each of shape (rank, count, count), on Chebyshev points of the window and of the lens.

    The eigenvectors of the Gram matrix are the right singular vectors; squared singular values below 1e-14 of the
    largest are lost in rounding, hence the smallest tolerance of 1e-7.
    """
    count = chebyshev.points_needed(rest_rad, tolerance)
    x, y = np.meshgrid(*(chebyshev.points(span, count) for span in lens_um))
    u, v = np.meshgrid(*(chebyshev.points(span, count) for span in (window_um, window_um)))
    x, y, u, v = x.reshape(-1, 1), y.reshape(-1, 1), u.reshape(1, -1), v.reshape(1, -1)
    _, _, rest = _changes_um(target_um, x, y, u, v)
    distance = np.sqrt((target_um[0] + u - x) ** 2 + (target_um[1] + v - y) ** 2 + target_um[2] ** 2)
    spreading = target_um[2] / (2.0 * np.pi * distance**2) * (1.0 / distance - 1j * k)
    kernel = spreading * np.exp(1j * k * rest)
    squares, vectors = np.linalg.eigh(kernel.conj().T @ kernel)
    lost = np.cumsum(np.maximum(squares, 0.0))
    first = min(int(np.searchsorted(lost, tolerance**2 * lost[-1])), squares.size - 1)
    kept = vectors[:, first:]
    shape = (-1, count, count)
    return kept.conj().T.reshape(shape), (kernel @ kept).T.reshape(shape)


def _changes_um(
    target_um: tuple[float, float, float], x: Any, y: Any, u: Any, v: Any
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """X(x, u), Y(y, v) and the rest of R(x, y; u, v) - R(x, y; 0, 0) - R(0, 0; u, v) + R(0, 0; 0, 0)."""
    c_x, c_y, c_z = target_um

    def change(x: Any, y: Any, u: Any, v: Any) -> FloatArray:
        return np.asarray(
            np.sqrt((c_x + u - x) ** 2 + (c_y + v - y) ** 2 + c_z**2)
            - np.sqrt((c_x - x) ** 2 + (c_y - y) ** 2 + c_z**2)
            - np.sqrt((c_x + u) ** 2 + (c_y + v) ** 2 + c_z**2)
            + math.hypot(c_x, c_y, c_z)
        )

    along_x, along_y = change(x, 0.0, u, 0.0), change(0.0, y, 0.0, v)
    return along_x, along_y, change(x, y, u, v) - along_x - along_y
