"""Faults of input files: in our words, with a neighbour for a misspelt key, term or choice."""

from __future__ import annotations

from typing import Any

import pytest

from metafab.core.errors import InputError
from metafab.spec import Design, Device, Mask, UnitCell
from metafab.spec.toml import validate

DEVICE: dict[str, Any] = {"aperture_um": 100.0, "focal_length_mm": 1.0}


def _message(spec: Any, table: dict[str, Any]) -> str:
    with pytest.raises(InputError) as caught:
        validate(spec, table, "design.toml")
    return str(caught.value)


@pytest.mark.parametrize(
    ("spec", "table", "expected"),
    [
        (Device, DEVICE | {"apperture_shape": "ring"}, "did you mean `aperture_shape`"),
        (Device, DEVICE | {"aperture_shape": "circel"}, "did you mean `circle`?"),
        (Device, DEVICE | {"aperture_um": "100"}, "`aperture_um`: expected a number, got '100'"),
        (Device, DEVICE | {"aperture_um": -1}, "expected a number greater than 0, got -1"),
        (Device, DEVICE | {"outline_um": 3}, "`outline_um`: expected a list, in square brackets, got 3"),
        (Mask, {"chip": {"marginum": 1}}, "`chip.marginum`: expected a known key, got an unknown one; did you mean"),
        (Mask, {"chip": {"zzz": 1}}, "known keys: margin_um, mark_um"),
        (Mask, {"chip": 3}, "`chip`: expected a table, got 3"),
        (Mask, {"copies": [{"at_um": [1]}]}, "`copies[0].at_um`: expected a list of at least 2, got a list of 1"),
        (Mask, {"copies": [{"at_um": []}]}, "`copies[0].at_um`: expected a list of at least 2, got a list of 0"),
        (Mask, {"flat": "yes"}, "`flat`: expected true or false, got 'yes'"),
        (Mask, {"layer": 1.5}, "`layer`: expected a whole number, got 1.5"),
        (Design, {"phase": [{"term": "spiral_zone"}]}, "did you mean `spiral_zones`?"),
        (Design, {"phase": [{"term": "geometric"}]}, "pillars stand upright"),
        (UnitCell, {"cell": {"shape": "hexagon"}}, "on a hexagonal lattice"),
        (Design, {"phase": [{}]}, "`phase[0].term`: expected the name of a phase term, got nothing"),
        (Design, {"phase": {"term": "lens"}}, "expected a list of tables, each headed [[phase]], got one table"),
        (Design, {"phase": [{"term": "lens", "object_depth": 1}]}, "did you mean `object_depth_m`?"),
        (Design, {"name": "a b"}, "expected letters, digits, `_`, `-` and `.`, a letter or digit first, got 'a b'"),
    ],
)  # fmt: skip
def test_a_fault_is_said_in_our_words(spec: Any, table: dict[str, Any], expected: str) -> None:
    message = _message(spec, table)
    assert expected in message
    for foreign in ("Input", "String should", "Tuple", "tag", "Unexpected keyword", "instance of"):
        assert foreign not in message


def test_faults_of_items_are_not_followed_by_one_about_the_length_of_their_list() -> None:
    assert "at least 1" not in _message(Design, {"phase": [{"term": "lense"}]})
    assert "`phase`: expected a list of at least 1, got []" in _message(Design, {"phase": []})


def test_a_list_without_items_has_one_fault() -> None:
    assert _message(Mask, {"copies": [{"at_um": []}]}).count("\n") == 1
