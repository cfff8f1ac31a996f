"""Dataclasses become JSON tables and come back equal."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass

import numpy as np
import pytest

from metafab.core.conventions import FloatArray
from metafab.core.storage.files import plain
from metafab.core.storage.tables import optional, typed


@dataclass(frozen=True)
class Inner:
    name: str
    factor: tuple[float, float] | None


@dataclass(frozen=True)
class Outer:
    count: int
    sizes: tuple[float, ...]
    parts: tuple[Inner, ...]
    map: FloatArray
    by_name: dict[str, Inner]
    error: float
    reason: str | None = optional()
    share: float | None = optional()


WHOLE = Outer(3, (1.0, math.inf), (Inner("a", (0.5, 1.0)), Inner("b", None)), np.eye(2), {"c": Inner("c", None)}, 0.5)


def _returned(value: Outer) -> Outer:
    return typed(Outer, json.loads(json.dumps(plain(value))))


def test_a_dataclass_comes_back_from_its_table() -> None:
    back = _returned(WHOLE)
    np.testing.assert_array_equal(back.map, WHOLE.map)
    assert (back.count, back.sizes, back.parts, back.by_name) == (3, (1.0, math.inf), WHOLE.parts, WHOLE.by_name)
    assert back.reason is None and back.share is None


def test_an_optional_field_is_left_out_and_nan_is_null() -> None:
    table = plain(Outer(1, (), (), np.zeros(1), {}, math.nan, share=math.nan))
    assert "reason" not in table
    assert table["error"] is None and table["share"] is None
    back = typed(Outer, table)
    assert math.isnan(back.error) and back.share is not None and math.isnan(back.share)


def test_unknown_keys_are_ignored_and_missing_ones_refused() -> None:
    table = plain(WHOLE)
    assert typed(Outer, table | {"later": 1}).count == 3
    with pytest.raises(TypeError, match="count"):
        typed(Outer, {name: value for name, value in table.items() if name != "count"})
    with pytest.raises(TypeError, match="expected a table of Inner"):
        typed(Outer, table | {"parts": [3]})
