"""Change of the amplitudes of made pillars from those of the mask, whose sizes are others."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.layout import PillarMap
from metafab.layout.pillars import Lattice
from metafab.optics.sources.source import WrittenField
from metafab.tolerance.corners import CornerField

_LATTICE = Lattice(period_dbu=(800, 800), shape=(300, 4), database_unit_nm=0.5)


def _field(index: np.ndarray, table: np.ndarray) -> WrittenField:
    sizes = np.array([[0, 0], *([200 + 10 * k] * 2 for k in range(1, len(table)))], dtype=np.int32)
    return WrittenField(PillarMap.from_array(_LATTICE, sizes, index.astype(np.uint16), 64), table)


def test_the_change_of_made_pillars_is_that_from_the_mask_at_each_site() -> None:
    rng = np.random.default_rng(0)
    drawn = rng.integers(0, 3, _LATTICE.shape)
    made = np.where(drawn > 0, rng.integers(1, 6, _LATTICE.shape), 0)
    tables = [rng.normal(size=(count, 2)) + 1j * rng.normal(size=(count, 2)) for count in (3, 6)]
    for table in tables:
        table[0] = 0.0
    written, corner = _field(drawn, tables[0]), CornerField("printed", _field(made, tables[1]), 0.01, 1e-17, 5)
    a, b = tables[0][drawn], tables[1][made]
    common = np.sum(b * a.conj(), axis=(0, 1)) / np.sum(np.abs(a) ** 2, axis=(0, 1))
    change = np.linalg.norm(b - common * a) / np.linalg.norm(a)
    found = corner.against(written)
    assert found.change == pytest.approx(change)
    assert found.relative_error == pytest.approx(0.01 / change)


def test_a_common_factor_is_no_change() -> None:
    drawn = np.random.default_rng(0).integers(0, 3, _LATTICE.shape)
    table = np.array([[0.0, 0.0], [1.0, 1.0j], [0.5, -1.0]], dtype=np.complex128)
    corner = CornerField("printed", _field(drawn, np.array([0.9j, 0.8]) * table), 0.01, 1.0, 0)
    assert corner.against(_field(drawn, table)).change < 1e-7
