"""Solved rows by their length, with the weights that they have in the fit of a chain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from metafab.cell.supercell import Supercell
from metafab.core.conventions import POLARISATIONS, ComplexArray, FloatArray, Polarisation
from metafab.library.neighbours.rows import ROW_KINDS, RowSampler, is_steady, kind_of
from metafab.library.neighbours.training.fit import RowSet

#: Solved amplitudes by number of the row.
Answers = dict[int, tuple[complex, ...]]

#: Weight of the rows with steady phases in the fit. Lenses consist of such rows, and their residuals are three to eight
#: times smaller than those of random sizes.
_STEADY_WEIGHT = 16.0
#: Weight of the squared residual of the strongest order of a row with steady phases, the wanted order of a lens.
#: Measured on 28 rows of a lens, light along: amplitude of the wanted order off by 0.0041 with 1, 0.0033 with 8 and
#: 0.0026 with 30 (rms), while rows of random sizes are off by 0.12, 0.13 and 0.15.
_STRONGEST_WEIGHT = 8.0
#: Sites of a row of weight 1. Longer rows hold more orders and count in proportion.
_SITES = 7.0
#: Part of the light cone beyond which an order is grazing, and the weight of its squared residual in the fit.
_GRAZING, _GRAZING_WEIGHT = 0.95, 0.3


def row_sets(sampler: RowSampler, answers: Answers, numbers: Sequence[int]) -> list[RowSet]:
    """Rows by their length."""
    sets = []
    for sites in sorted({kind.sites for kind in ROW_KINDS}):
        of_length = [number for number in numbers if kind_of(number).sites == sites]
        if of_length:
            size_nm = np.stack([sampler.pillars(number) for number in of_length])
            order, weight = _orders(Supercell(sampler.cell, size_nm[:1]), sampler.polarisation)
            amplitude = np.array([answers[number] for number in of_length]).reshape(len(size_nm), 2, -1)
            sets.append(RowSet(size_nm, local_amplitudes(sampler, size_nm), amplitude.swapaxes(0, 1), order, weight))
    return sets


def local_amplitudes(sampler: RowSampler, size_nm: FloatArray) -> ComplexArray:
    """The library's r and t of pillars, shape (rows, sites, 2) to (2, rows, sites)."""
    place = {tuple(size): k for k, size in enumerate(sampler.size_nm)}
    at = np.reshape([place[tuple(size)] for size in size_nm.reshape(-1, 2)], size_nm.shape[:-1])
    return np.stack([sampler.r, sampler.t])[..., POLARISATIONS.index(sampler.polarisation)][:, at]


def weighted_sets(sampler: RowSampler, answers: Answers, numbers: Sequence[int] | None = None) -> list[RowSet]:
    """Rows by their length, with weights for a fit; those with steady phases also by their strongest order."""
    weighted, numbers = [], sorted(answers) if numbers is None else numbers
    for rows in row_sets(sampler, answers, [number for number in numbers if not is_steady(number)]):
        weighted.append(replace(rows, weight=rows.weight * rows.size_nm.shape[1] / _SITES))
    for rows in row_sets(sampler, answers, [number for number in numbers if is_steady(number)]):
        strongest = np.argmax(np.abs(rows.amplitude[1]), axis=1)
        for order in np.unique(strongest):
            weight = _STEADY_WEIGHT * rows.weight * rows.size_nm.shape[1] / _SITES
            weight[order] *= _STRONGEST_WEIGHT
            weighted.append(replace(rows.part(strongest == order), weight=weight))
    return weighted


def _orders(supercell: Supercell, light: Polarisation) -> tuple[FloatArray, FloatArray]:
    """Numbers of a row's orders, and the weights of their squared residuals, shape (orders,) each."""
    order, cell = supercell.propagating_orders(light), supercell.cell
    sine = np.hypot(*supercell.wavevectors_per_um(order).T) / (1e3 * cell.k0_per_nm)
    sine = sine / cell.n_out[POLARISATIONS.index(light)].real
    return order[:, 0].astype(np.float64), np.where(sine > _GRAZING, _GRAZING_WEIGHT, 1.0)
