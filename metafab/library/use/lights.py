"""Sizes for several lights together: the largest weighted sum of field overlaps.

The overlap of a size with the targets of all lights is sum_k w_k sum_p Re(t_kp exp(-i phi_kp)) over the lights k, with
weights w_k, and the polarisations p. It is an inner product in 4 K dimensions for K lights. A table over the 2 K phases
would be too large, so each site compares all sizes by a matrix product.

A constant phase added to the targets of one light and polarisation changes no image. These constants decide how well
one size can serve all lights; alternating maximisation finds them from several starts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray, wrap_phase
from metafab.library.library import Library
from metafab.library.use.amplitudes import empty_cell_t, half_space_indices, power_ratio_of
from metafab.library.use.lookup import SizeTable, trust

#: Starts of the search for constant phases, and most alternations of each.
_STARTS, _ALTERNATIONS = 16, 60
#: Largest difference of equal overlaps, over the largest possible one. Of equal ones the smallest index wins, whatever
#: the rounding of the matrix product.
_EQUAL = 1e-12
#: Overlaps of sizes and sites held at once (32 MB), and in the search for constant phases, which takes fewer sites.
_HELD, _SEARCHED = 1 << 22, 1 << 20


@dataclass(frozen=True)
class SizesOfLights:
    """Choice of the size whose fields overlap best with the targets of K lights."""

    tables: tuple[SizeTable, ...]  #: Sizes with the transmission of each light; the same sizes in all.
    #: Shape (n_sizes, 4 K), real and imaginary parts of t of each light and polarisation, times the light's weight;
    #: smaller where t is not known to the target error.
    field: FloatArray

    @classmethod
    def of(cls, table: SizeTable, libraries: Sequence[Library], weights: Sequence[float]) -> SizesOfLights:
        """Return the choice among the sizes of ``table``, by the libraries and positive weights of K lights.

        InputError if a library lacks a size.
        """
        width_nm, length_nm = (table.size_dbu[1:] * table.database_unit_nm).T
        tables, fields = [], []
        for library, weight in zip(libraries, weights, strict=True):
            found = library.at_sizes(width_nm, length_nm)
            t = np.stack([found.t_xx, found.t_yy], axis=-1)
            of_light = np.concatenate([empty_cell_t(library.unit_cell)[None], t])
            tables.append(replace(table, t=of_light, error=np.concatenate([[0.0], found.error])))
            # Oblique light counts by the power that it carries along z.
            n_in, n_out = half_space_indices(library.unit_cell)
            oblique = np.sqrt(power_ratio_of(library) / (n_out.real / n_in.real))
            weighted = weight * oblique * t * trust(t, found.error, library.unit_cell.sweep.target_error)
            fields.append(np.stack([weighted.real, weighted.imag], axis=-1).reshape(len(t), 4))
        return cls(tuple(tables), np.concatenate(fields, axis=1))

    def best(self, target_rad: FloatArray) -> tuple[NDArray[np.uint16], FloatArray]:
        """Find the best size for target phases of all lights, shape (K, 2, ...).

        Returns the row of the tables, counted from 1, and its weighted overlap: shape (...) each.
        """
        targets = target_rad.reshape(2 * len(self.tables), -1)
        count = targets.shape[1]
        index = np.empty(count, dtype=np.uint16)
        overlap = np.empty(count)
        scale = float(np.linalg.norm(self.field, axis=1).max()) * np.sqrt(2.0 * len(self.tables))
        for sites in np.array_split(np.arange(count), -(-count * len(self.field) // _HELD)):
            overlaps = self._overlaps(targets[:, sites])
            overlap[sites] = overlaps.max(axis=1)
            index[sites] = np.argmax(overlaps >= overlap[sites, None] - _EQUAL * scale, axis=1) + 1
        shape = target_rad.shape[2:]
        return index.reshape(shape), overlap.reshape(shape)

    def constant_phases(self, target_rad: FloatArray, keeps_retardance: Sequence[bool] = ()) -> FloatArray:
        """Return the constants that, added to the targets, give the largest total overlap found: (K, 2), in (-pi, pi].

        ``target_rad``, shape (K, 2, n), holds the target phases at n sites; of many sites every k-th is taken.
        ``keeps_retardance``, K flags, marks lights whose x and y share one constant; none by default.
        """
        lights = len(self.tables)
        step = max(1, -(-target_rad.shape[-1] * len(self.field) // _SEARCHED))
        targets = target_rad[..., ::step].reshape(2 * lights, -1)
        fields = (self.field[:, 0::2] + 1j * self.field[:, 1::2]).T
        draws = np.random.default_rng(0).uniform(-np.pi, np.pi, (_STARTS, 2 * lights))
        draws[0] = 0.0
        kept = np.flatnonzero(keeps_retardance)
        draws[:, 2 * kept + 1] = draws[:, 2 * kept]
        best, best_total = draws[0], -np.inf
        for start in draws:
            offsets, total = start, -np.inf
            for _ in range(_ALTERNATIONS):
                overlaps = self._overlaps(targets + offsets[:, None])
                chosen = np.argmax(overlaps, axis=1)
                reached = float(np.take_along_axis(overlaps, chosen[:, None], axis=1).sum())
                if reached <= total * (1.0 + 1e-9):
                    break
                total = reached
                sums = np.sum(fields[:, chosen] * np.exp(-1j * targets), axis=1)
                sums[2 * kept] = sums[2 * kept + 1] = sums[2 * kept] + sums[2 * kept + 1]
                offsets = np.where(np.abs(sums) > 0.0, np.angle(sums), offsets)
            if total > best_total * (1.0 + 1e-9):
                best, best_total = offsets, total
        return wrap_phase(best.reshape(lights, 2))

    def _overlaps(self, targets: FloatArray) -> FloatArray:
        """Weighted overlap of each size at n sites, shape (n, n_sizes), with targets of the shape (2 K, n)."""
        turned = np.stack([np.cos(targets), np.sin(targets)], axis=1).reshape(2 * len(targets), -1)
        return np.asarray(turned.T @ self.field.T)
