"""Processor time of the matrix products and linear systems of RCWA, by themselves."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from scipy.linalg import lapack

from metafab.cell import CellResponse
from metafab.cell.rcwa.certificate import RcwaDetails, ladder
from metafab.cell.rcwa.convergence import convergence
from metafab.cell.rcwa.scattering.doubling import THIN
from metafab.cell.rcwa.symmetry import polarisations_swap


def algebra_s(answers: Iterable[CellResponse]) -> float:
    """Processor time of the matrix products and linear systems that solve upright rectangles under light along z.

    For each truncation and polarisation: four products for the powers of P Q, a linear system for the thin slab and one
    for each doubling but the last, a product for each of these but the first, and a product and a linear system for the
    waves outside. As many doublings are counted as travelling modes need.
    """
    orders = []
    for answer in answers:
        cell, details, rungs = answer.cell, answer.details, ladder(answer.numerics, convergence(answer.cell))
        assert isinstance(details, RcwaDetails)  # rectangles are solved by it
        phase = cell.k0_per_nm * cell.height_nm * max(abs(complex(cell.n_pillar)), abs(complex(cell.n_ambient)))
        doublings = max(1, math.ceil(math.log2(phase / THIN))) - 1
        polarisations = 1 if polarisations_swap(cell) else 2
        orders += [(each, doublings) for each in rungs if each <= details.orders_x] * polarisations
    return sum(orders.count(each) * _doubled_s(*each) for each in set(orders))


def _doubled_s(orders: int, doublings: int) -> float:
    """Processor time of one truncation and polarisation, ``doublings`` of them before the last."""
    count = 2 * orders * (orders + 1) + 1
    one, other = np.random.default_rng(1).standard_normal((2, count, count)) + 0.1j
    out = np.empty_like(one)
    product = least_seconds(lambda: np.matmul(one, other, out=out), 10)
    system = least_seconds(lambda: lapack.zgesv(one.T, other.T), 10)
    return (5 + max(0, doublings - 1)) * product + (2 + doublings) * system


def least_seconds(work: Callable[[], Any], rounds: int = 3, seconds: Callable[[], float] = time.process_time) -> float:
    """Least processor time of a few rounds, or that by another clock ``seconds``."""
    found = []
    for _ in range(rounds):
        begun = seconds()
        work()
        found.append(seconds() - begun)
    return min(found)
