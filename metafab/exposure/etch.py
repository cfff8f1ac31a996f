"""Sizes of etched pillars: printed sizes, changed by the etch bias and by its dependence on the local density.

Microloading is linear: where the pillars cover more of the surface than on average, the etch consumes its reactants and
leaves wider pillars (or narrower ones, by the sign),

    size = printed + bias + microloading (density - mean density),

with the density of the printed pillars, averaged by a Gaussian of the given range.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from metafab.core.conventions import Float32Array, FloatArray
from metafab.core.errors import InputError
from metafab.exposure.electrons.beam import BeamPsf
from metafab.exposure.energy.far import LongRange, block_masses
from metafab.exposure.results import Exposure
from metafab.layout import PillarMap
from metafab.layout.outlines import RECTANGLE, Outline
from metafab.layout.pillars import bands, resized
from metafab.spec.mask import BeamTerm, Etch

#: Shortest range of the microloading, in periods: three blocks.
_LEAST_PERIODS = 12.0


@dataclass(frozen=True)
class MadePillars:
    """Pillars as they are made."""

    pillars: PillarMap  #: Sizes after the etch, in steps of the database unit; unprinted pillars are missing.
    bias_nm: float  #: Mean of made less drawn size.
    bias_rms_nm: float  #: Rms of made less drawn size about the mean.
    missing: int  #: Pillars that are not printed, or etched away.
    density: float  #: Mean share of the surface under printed pillars, weighted by pillars.
    narrowest_nm: float  #: Smallest width or length of a made pillar; inf if none is left.


def made_pillars(wanted: PillarMap, exposed: Exposure, etch: Etch, outline: Outline = RECTANGLE) -> MadePillars:
    """Return the pillars that an exposure and an etch leave.

    The bias counts from the sizes of ``wanted``, the mask before correction; ``exposed`` is its exposure, with
    ``keep_sizes``. A printed pillar covers the same share of its width times length as its drawn ``outline``.
    InputError if printed sizes were not kept, or ``microloading_range_um`` is below 12 periods.
    """
    change = exposed.printed_less_drawn_nm
    if change is None:
        raise InputError.single("exposure", "keep_sizes", "true", "false")
    drawn, index = exposed.drawn, exposed.drawn.to_array()
    drawn_nm = drawn.size_nm().astype(np.float32).T
    wanted_nm, wanted_index = wanted.size_nm().astype(np.float32).T, wanted.to_array()

    def printed_nm(rows: slice) -> Float32Array:
        size = drawn_nm[:, index[rows]] + change[:, rows]
        return np.asarray(np.where((index[rows] > 0) & np.isfinite(size).all(axis=0), size, 0.0), dtype=np.float32)

    drawn_box = np.maximum(np.prod(drawn.size_dbu.astype(np.float64), axis=1), 1.0)
    covered = outline.area(drawn.size_dbu) / drawn_box

    def area_nm2(rows: slice) -> FloatArray:
        return np.asarray(printed_nm(rows).astype(np.float64).prod(axis=0) * covered[index[rows]])

    density, mean = local_density(drawn, area_nm2, etch) if etch.microloading_nm else (None, 0.0)

    def made_nm(rows: slice) -> FloatArray:
        size = printed_nm(rows)
        shift: Float32Array | float = etch.bias_nm
        if density is not None:
            local = density.at(rows, slice(0, index.shape[1]))
            shift = np.float32(etch.bias_nm) + np.float32(etch.microloading_nm) * (local - np.float32(mean))
        return np.asarray(np.where(size > 0.0, size + shift, np.nan), dtype=np.float64)

    pillars = resized(drawn, made_nm)
    made_sizes, made_index = pillars.size_nm().T, pillars.to_array()
    total, square, count, narrowest_nm = 0.0, 0.0, 0, math.inf
    for rows in bands(index):
        stand = made_index[rows] > 0
        here = made_sizes[:, made_index[rows][stand]]
        bias = here - wanted_nm[:, wanted_index[rows][stand]]
        narrowest_nm = min(narrowest_nm, float(here.min(initial=math.inf)))
        total, square, count = total + float(bias.sum()), square + float((bias**2).sum()), count + bias.size
    bias_nm = total / max(1, count)
    rms_nm = float(np.sqrt(max(0.0, square / max(1, count) - bias_nm**2)))
    missing = int(np.count_nonzero(index)) - count // 2
    return MadePillars(pillars, bias_nm, rms_nm, missing, mean, narrowest_nm)


def local_density(pillars: PillarMap, area_nm2: Callable[[slice], FloatArray], etch: Etch) -> tuple[LongRange, float]:
    """Return the local density on blocks, averaged over ``microloading_range_um``, and its mean over the pillars.

    ``area_nm2`` returns the areas of the pillars on all sites of some rows, shape (n_rows, n_x), 0 without a pillar.
    InputError for a range below 12 periods.
    """
    lattice, index = pillars.lattice, pillars.to_array()
    least_nm = _LEAST_PERIODS * lattice.spacing_nm
    if etch.microloading_range_um * 1e3 < least_nm:
        expected = f"at least {_LEAST_PERIODS:g} periods, {least_nm * 1e-3:g} um"
        raise InputError.single("process.etch", "microloading_range_um", expected, f"{etch.microloading_range_um:g} um")
    masses = [block_masses(area_nm2(rows)) for rows in bands(index)]
    beam = BeamPsf.of([BeamTerm("gauss", 1.0, etch.microloading_range_um * 1e3)], "")
    density = LongRange.of(beam, np.concatenate(masses), lattice.period_nm)
    assert density is not None
    total, count = 0.0, 0
    for rows in bands(index):
        local = density.at(rows, slice(0, index.shape[1]))[index[rows] > 0]
        total, count = total + float(local.sum(dtype=np.float64)), count + local.size
    return density, total / max(1, count)
