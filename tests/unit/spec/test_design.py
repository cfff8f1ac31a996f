"""Every key of a design and of a unit cell with every kind of fault: refused by name, or taken, and never a crash."""

from __future__ import annotations

import copy
import math
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import tomli_w

from metafab.core.errors import InputError
from metafab.spec import load_design, load_unit_cell
from metafab.spec.fields import LARGEST
from metafab.steps import preflight
from tests.main_job import SMALL, UNIT_CELL

Place = tuple[str | int, ...]

DESIGN = tomllib.loads(SMALL.read_text(encoding="utf-8")) | {"library": str(UNIT_CELL)}
CELL = tomllib.loads(UNIT_CELL.read_text(encoding="utf-8"))

#: A value in place of a number, a text or a list of numbers, none of which takes it.
NO_NUMBERS: dict[str, Any] = {
    "text": "abc", "number in quotes": "3.5", "empty": "", "list": [], "table": {"a": 1}, "boolean": True,
    "nan": math.nan, "infinity": math.inf, "huge": 1e300, "beyond 64 bits": 10**18 * LARGEST,
}  # fmt: skip
NO_TEXTS: dict[str, Any] = {"number": 3.5, "list": [], "table": {"a": 1}, "boolean": True}
#: Numbers that may be below zero.
SIGNED = {"centre"}
#: Lists of texts that may hold none.
MAY_BE_EMPTY = {"formats"}


def leaves(table: Any, place: Place = ()) -> Iterator[tuple[Place, Any]]:
    """Every value that is no table and no list of tables, with its place."""
    if isinstance(table, dict):
        for key, value in table.items():
            yield from leaves(value, (*place, key))
    elif isinstance(table, list) and isinstance(table[0], dict):
        for index, value in enumerate(table):
            yield from leaves(value, (*place, index))
    else:
        yield place, table


def changed(table: dict[str, Any], place: Place, value: Any) -> dict[str, Any]:
    """A copy with another value at a place, or without it for None."""
    whole = copy.deepcopy(table)
    inner: Any = whole
    for step in place[:-1]:
        inner = inner[step]
    if value is None:
        del inner[place[-1]]
    else:
        inner[place[-1]] = value
    return whole


def faults(table: dict[str, Any], folder: Path) -> str:
    """What is said of a design or unit cell before any work begins; nothing if it would be taken."""
    path = folder / "case.toml"
    path.write_text(tomli_w.dumps(table), encoding="utf-8")
    try:
        if "device" in table:
            preflight(load_design(path))
        else:
            load_unit_cell(path)
    except InputError as error:
        # A sentence over several fields names them itself.
        assert all(fault.expected and (fault.got or "`" in fault.expected) for fault in error.faults)
        return "\n".join(f"{fault.field}: {fault.expected}, got {fault.got}" for fault in error.faults)
    return ""


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


ALL = [
    pytest.param(table, place, value, id=f"{name} {'.'.join(map(str, place))}")
    for name, table in (("design", DESIGN), ("cell", CELL))
    for place, value in leaves(table)
    if place != ("library",)
]


def test_the_table_covers_both_files() -> None:
    assert len(ALL) >= 50


@pytest.mark.parametrize(("table", "place", "value"), ALL)
def test_what_a_key_cannot_hold_is_refused_by_its_name(
    table: dict[str, Any], place: Place, value: Any, tmp_path: Path
) -> None:
    numbers = isinstance(value, list) and _number(value[0])
    wrong = dict(NO_NUMBERS if _number(value) or numbers else NO_TEXTS)
    if place[-1] in MAY_BE_EMPTY:
        del wrong["list"]
    if _number(value) and value != 0 and place[-1] not in SIGNED:
        wrong["negative"] = -value
    if numbers:
        wrong |= {f"{name} inside": [bad, *value[1:]] for name, bad in NO_NUMBERS.items() if name != "table"}
        if place[-1] not in SIGNED:
            wrong["negative inside"] = [-1.0, *value[1:]]
    for name, bad in wrong.items():
        said = faults(changed(table, place, bad), tmp_path)
        assert str(place[-1]) in said, f"{name}: {said or 'taken'}"


@pytest.mark.parametrize(("table", "place", "value"), ALL)
def test_wrong_units_and_missing_keys_are_taken_or_told(
    table: dict[str, Any], place: Place, value: Any, tmp_path: Path
) -> None:
    """A thousand times too much or too little may be a device, too; what is none is told, and nothing breaks."""
    faults(changed(table, place, None), tmp_path)
    for factor in (1e3, 1e-3, 1e6, 1e-6):
        if _number(value):
            faults(changed(table, place, factor * value), tmp_path)
        elif isinstance(value, list) and _number(value[0]):
            faults(changed(table, place, [factor * item for item in value]), tmp_path)


@pytest.mark.parametrize(
    ("place", "value", "field"),
    [
        (("rules", "min_feature_nm"), 100_000.0, "rules.min_feature_nm"),
        (("rules", "min_gap_nm"), 100_000.0, "rules.min_gap_nm"),
        (("rules", "min_gap_nm"), 251.0, "rules.min_gap_nm"),
        (("mask", "database_unit_nm"), 500.0, "cell.period_nm"),
        (("scene", "objects", 0, "centre"), [0.0, 62.0], "scene.objects[0].centre"),
        (("scene", "objects", 2, "centre"), [-1.0, -0.075], "scene.objects[2].centre"),
        (("device", "focal_length_mm"), 1000.0, "sensor.focus_depth_m"),
        (("verify", "depths_m"), [0.0000028, 0.0028], "verify.depths_m[0]"),
    ],
)
def test_what_cannot_work_is_told_before_any_work(place: Place, value: Any, field: str, tmp_path: Path) -> None:
    assert any(line.startswith(field) for line in faults(changed(DESIGN, place, value), tmp_path).splitlines())


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("rules", "min_gap_nm"), 250.0),  # two pillars of 100 nm in periods of 350 nm just keep it
        (("rules", "min_feature_nm"), 250.0),
        (("scene", "objects", 0, "centre"), [0.0, 0.16]),  # half out of sight
    ],
)
def test_what_just_works_is_taken(place: Place, value: Any, tmp_path: Path) -> None:
    table = changed(DESIGN, place, value)
    if place[-1] == "min_feature_nm":
        table["rules"]["min_gap_nm"] = 100.0
    assert faults(table, tmp_path) == ""


@pytest.mark.parametrize(
    ("table", "place", "value", "said"),
    [
        (CELL, ("cell", "height_nm"), 0.6, "`cell.height_nm` = 0.6"),
        (CELL, ("cell", "height_nm"), 600_000.0, "`cell.height_nm` = 600000"),
        (CELL, ("cell", "period_nm"), 0.35, "period_nm"),
        (CELL, ("sweep", "width_nm"), [2.0, 250.0], "`sweep.width_nm` = 2"),
        (DESIGN, ("rules", "min_gap_nm"), 0.1, "`rules.min_gap_nm` must be at least 0.8 nm"),
        (DESIGN, ("rules", "min_feature_nm"), 0.1, "`rules.min_feature_nm` must be at least 0.8 nm"),
    ],
)
def test_micrometres_are_not_taken_for_nanometres(
    table: dict[str, Any], place: Place, value: Any, said: str, tmp_path: Path
) -> None:
    assert said in faults(changed(table, place, value), tmp_path)
