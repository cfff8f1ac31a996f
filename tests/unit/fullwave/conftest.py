"""Fixtures of pieces of a mask: rows of seven sizes, and a library whose phase rises along them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell.meep import SupercellSettings
from metafab.layout import Lattice, PillarMap
from metafab.library import Library

#: Sites along x repeat after 7, so that a local period is known; along y all are alike.
PERIOD_SITES = 7
LATTICE = Lattice(period_dbu=(700, 700), shape=(60, 80), database_unit_nm=0.5)
QUICK = SupercellSettings(pixels_per_period=8, decay=1e-2)


@pytest.fixture(scope="module")
def pillars() -> PillarMap:
    """Widths that rise by 20 nm from site to site over each period; lengths fall by 10 nm."""
    step = np.arange(PERIOD_SITES)
    sizes = np.concatenate([[[0, 0]], 2 * np.stack([110 + 20 * step, 200 - 10 * step], axis=-1)])
    index = np.tile((np.arange(80) % PERIOD_SITES + 1).astype(np.uint16), (60, 1))
    return PillarMap.from_array(LATTICE, sizes.astype(np.int32), index, 16)


@pytest.fixture(scope="module")
def ramp_library(smooth_library: Library) -> Library:
    """x light sees a phase that rises by a seventh of a turn with every 20 nm of width; y light one that falls."""
    phase = 2.0 * np.pi * (smooth_library.width_nm - 110.0) / 20.0 / PERIOD_SITES
    t_xx = np.broadcast_to(0.9 * np.exp(1j * phase), smooth_library.t_xx.shape)
    return replace(smooth_library, t_xx=t_xx, t_yy=t_xx.conj())
