"""Supercells of a file: faults by name, lone pillars, and the solver's name that decides."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from metafab.cell import pillar_cell
from metafab.cell.elements.solve import ElementNumerics
from metafab.cell.supercell import Supercell, SupercellOrders
from metafab.core.errors import InputError, SolverError
from metafab.core.parallel.executor import SerialExecutor
from metafab.fullwave import blocks
from metafab.fullwave.blocks import BlockNumerics, Solver, read_blocks, solve_blocks
from metafab.fullwave.record import kept_blocks
from metafab.library import Library
from metafab.library.sweep.checkpoint import SolvedPoint
from tests.fake_meep import UncoupledPillars, response

ROW = {"width_nm": [[120.0, 150.0, 180.0]], "length_nm": [[180.0, 150.0, 130.0]]}


@pytest.mark.parametrize(
    ("blocks", "message"),
    [
        ([], "blocks"),
        ([{"width_nm": [[120.0, 130.0]], "length_nm": [[120.0]]}], "got rows of 2 sizes (1) and rows of 1 sizes (1)"),
        (
            [{"width_nm": [[120.0], [130.0, 140.0]], "length_nm": [[120.0], [130.0, 140.0]]}],
            "got rows of 1 to 2 sizes (2) and rows of 1",
        ),
        ([{"width_nm": [120.0], "length_nm": [[120.0]]}], "width_nm[0]`: expected a list, in square brackets, got 120"),
        ([{"width_nm": [[-1.0]], "length_nm": [[120.0]]}], "width_nm[0][0]"),
        ([{"width_nm": [["120"]], "length_nm": [[120.0]]}], "width_nm[0][0]"),
        ([{"width_nm": [[float("nan")]], "length_nm": [[120.0]]}], "width_nm[0][0]"),
        ([{"width_nm": [[400.0]], "length_nm": [[120.0]]}], "at most the period of 350 nm"),
        ([{"width_nm": [[0.0]], "length_nm": [[120.0]]}], "both 0"),
        ([{**ROW, "glass": 600.0}], "known keys: width_nm, length_nm"),
    ],
)
def test_faulty_blocks_are_refused(smooth_library: Library, tmp_path: Path, blocks: list[object], message: str) -> None:
    path = tmp_path / "blocks.json"
    path.write_text(json.dumps({"blocks": blocks}), encoding="utf-8")
    with pytest.raises(InputError) as refused:
        read_blocks(path, smooth_library)
    assert message in str(refused.value)


@pytest.mark.parametrize(
    ("solver", "width_nm", "message"),
    [
        ("model", 99.0, "blocks[1].width_nm`: expected 100 to 250 nm, the library's sweep, got 99 nm"),
        ("lone", 250.0000001, "got 250.0000001 nm"),
        ("model", 0.0, "an empty site"),
        (
            "rcwa",
            0.15,
            "expected 0, or at least 0.8 nm, a thousandth of the wavelength, got 0.15 nm; is it in nanometres?",
        ),
        ("lone", 0.0, None),
        ("rcwa", 99.0, None),
    ],
)
def test_sizes_that_the_library_does_not_hold_are_refused_before_any_is_solved(
    smooth_library: Library, tmp_path: Path, solver: Solver, width_nm: float, message: str | None
) -> None:
    path, length_nm = tmp_path / "blocks.json", 150.0 if width_nm else 0.0
    blocks = [ROW, {"width_nm": [[150.0, width_nm]], "length_nm": [[150.0, length_nm]]}]
    path.write_text(json.dumps({"blocks": blocks}), encoding="utf-8")
    if message is None:
        assert len(read_blocks(path, smooth_library, solver)) == 2
        return
    with pytest.raises(InputError) as refused:
        read_blocks(path, smooth_library, solver)
    assert message in str(refused.value)


@pytest.mark.parametrize(
    ("solver", "size_nm", "message"),
    [
        ("rcwa", np.linspace(110.0, 240.0, 100)[None], "blocks[1]`: expected a supercell of at most 5000 functions"),
        ("rcwa", np.array([[348.0, 150.0]]), "blocks[1]`: expected gaps between pillars of 1 % of the period or more"),
        ("meep", np.random.default_rng(1).uniform(100.0, 250.0, (40, 40)), "for 40 x 40 pillars at 24 pixels a period"),
    ],
)
def test_blocks_that_a_solver_does_not_treat_are_refused_by_number_before_any_is_solved(
    smooth_library: Library, tmp_path: Path, solver: Solver, size_nm: np.ndarray, message: str
) -> None:
    path = tmp_path / "blocks.json"
    refused = {"width_nm": size_nm.tolist(), "length_nm": np.full(size_nm.shape, 150.0).tolist()}
    path.write_text(json.dumps({"blocks": [ROW, refused]}), encoding="utf-8")
    with pytest.raises(InputError) as error:
        read_blocks(path, smooth_library, solver)
    assert message in str(error.value) and str(path) in str(error.value)
    path.write_text(json.dumps({"blocks": [ROW]}), encoding="utf-8")
    assert len(read_blocks(path, smooth_library, solver)) == 1


def _solved(
    supercell: Supercell, library: Library, solver: Solver, pool: UncoupledPillars | None = None
) -> SupercellOrders:
    (found,) = solve_blocks([supercell], library, solver, pool=pool)
    return found


@pytest.mark.parametrize(
    ("text", "message"), [("{", "JSON file"), ('{"blocks": [], "blocks": [{}]}', "key 'blocks' more than once")]
)
def test_no_json_is_refused(text: str, message: str, smooth_library: Library, tmp_path: Path) -> None:
    path = tmp_path / "text.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        read_blocks(path, smooth_library)


def test_equal_lone_pillars_have_the_error_of_the_library_and_unlike_ones_more(smooth_library: Library) -> None:
    cell = pillar_cell(smooth_library.unit_cell, 0.0, 0.0)
    equal, unlike = (
        Supercell(cell, np.array([[(w, 150.0) for w in widths]])) for widths in ((120,) * 3, (120, 240, 180))
    )
    assert _solved(equal, smooth_library, "lone").error < 2e-3
    assert _solved(unlike, smooth_library, "lone").error > 0.1
    small = Supercell(cell, np.array([[(20.0, 150.0)]]))
    with pytest.raises(InputError, match="sweep"):
        _solved(small, smooth_library, "lone")


def test_a_site_without_a_pillar_is_the_bare_substrate(smooth_library: Library) -> None:
    cell = pillar_cell(smooth_library.unit_cell, 0.0, 0.0)
    found = _solved(Supercell(cell, np.zeros((1, 1, 2))), smooth_library, "lone")
    bare = 2.0 * 1.7601 / 2.7601 * np.exp(2j * np.pi * 600.0 / 800.0)
    np.testing.assert_allclose(found.t[0], bare * np.eye(2), atol=2e-4)


def test_fdtd_solves_both_polarisations_on_all_grids(smooth_library: Library) -> None:
    """Pillars in place of Meep that do not couple and are alike on all grids, so that nothing is left as error."""
    cell = replace(pillar_cell(smooth_library.unit_cell, 0.0, 0.0), n_pillar=3.7)
    row = Supercell(cell, np.stack([ROW["width_nm"], ROW["length_nm"]], axis=-1))
    found = _solved(row, smooth_library, "meep", UncoupledPillars({(1, 0): 0.03}, tail=0.0))
    own = np.array([response(*size) for size in row.size_nm[0]])
    expected = row.local_period(found.order, own[None]) + 0.03 * (found.order[:, 0] == 1)
    for axis in range(2):
        np.testing.assert_allclose(found.t[:, axis, axis], expected, atol=1e-6)
    assert found.error < 1e-6


class CountedCalls(SerialExecutor):
    """Executor that counts the calls which it gets."""

    def __init__(self) -> None:
        self.calls = 0

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.calls += 1
        return super().submit(fn, *args, **kwargs)


def _answer(supercell: Supercell) -> SupercellOrders:
    """An answer in place of a solver's, unlike for unlike pillars."""
    order = supercell.propagating_orders("x")
    t = np.linspace(0.0, supercell.size_nm.sum(), 4 * len(order)).reshape(-1, 2, 2) / 7.0 + 0.3j
    return SupercellOrders(supercell, order, t, 0.01, 2.0)


def _rows(library: Library, count: int) -> list[Supercell]:
    cell, rng = pillar_cell(library.unit_cell, 0.0, 0.0), np.random.default_rng(1)
    return [Supercell(cell, rng.uniform(100.0, 250.0, (1, 3, 2))) for _ in range(count)]


def test_workers_solve_blocks_by_the_model_but_no_rows(
    smooth_library: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(blocks, "solve_supercell", lambda _, supercell: _answer(supercell))
    rows, executor = _rows(smooth_library, 4), CountedCalls()
    squares = [Supercell(row.cell, np.concatenate([row.size_nm, row.size_nm[:, ::-1]])) for row in rows]
    mixed = [*rows[:2], *squares, *rows[2:]]
    found = solve_blocks(mixed, smooth_library, "model", executor=executor)
    assert executor.calls == 4
    for orders, supercell in zip(found, mixed, strict=True):
        assert orders.supercell is supercell


def test_a_library_without_a_model_is_refused(smooth_library: Library) -> None:
    with pytest.raises(InputError, match="model of neighbours"):
        solve_blocks(_rows(smooth_library, 2), smooth_library, "model")


@pytest.mark.parametrize("failure", [SolverError("no answer"), np.linalg.LinAlgError("Singular matrix")])
def test_blocks_that_fail_are_named_and_all_others_are_kept(
    smooth_library: Library, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failure: Exception
) -> None:
    rows, solved, said = _rows(smooth_library, 5), list[Supercell](), list[str]()

    def solver(supercell: Supercell, library: Library) -> SupercellOrders:
        if any(np.array_equal(supercell.size_nm, rows[k].size_nm) for k in (1, 3)):
            raise failure
        solved.append(supercell)
        return _answer(supercell)

    monkeypatch.setattr(blocks, "lone_orders", solver)
    beside = tmp_path / "blocks.json"
    with (
        pytest.raises(SolverError, match=rf"blocks\[1\]: {failure}\nblocks\[3\]: {failure}"),
        kept_blocks(beside, "ab" * 32, said.extend) as record,
    ):
        solve_blocks(rows, smooth_library, "lone", record=record)
    assert len(solved) == 3
    (file,) = tmp_path.iterdir()
    assert file.name == "blocks.abababab.partial" and str(file) in said[0]

    # Without the two that fail, and in another order, nothing is left to solve.
    rest = [rows[k] for k in (4, 0, 2)]
    with kept_blocks(beside, "ab" * 32) as record:
        found = solve_blocks(rest, smooth_library, "lone", record=record)
    assert len(solved) == 3
    for orders, row in zip(found, rest, strict=True):
        expected = _answer(row)
        assert orders.supercell is row and (orders.error, orders.seconds) == (0.01, 2.0)
        np.testing.assert_array_equal(orders.order, expected.order)
        np.testing.assert_array_equal(orders.t, expected.t)
    assert not list(tmp_path.iterdir())


def test_an_interrupted_solution_keeps_its_blocks(
    smooth_library: Library, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows, solved = _rows(smooth_library, 4), list[Supercell]()

    def interrupted(supercell: Supercell, library: Library) -> SupercellOrders:
        if len(solved) == 2:
            raise KeyboardInterrupt
        solved.append(supercell)
        return _answer(supercell)

    monkeypatch.setattr(blocks, "lone_orders", interrupted)
    with pytest.raises(KeyboardInterrupt), kept_blocks(tmp_path / "answer.json", "cd" * 32) as record:
        solve_blocks(rows, smooth_library, "lone", record=record)
    monkeypatch.setattr(blocks, "lone_orders", lambda row, library: solved.append(row) or _answer(row))
    with kept_blocks(tmp_path / "answer.json", "cd" * 32) as record:
        solve_blocks(rows, smooth_library, "lone", record=record)
    assert len(solved) == 4


def test_nothing_stays_where_no_block_was_solved_or_the_folder_is_closed(
    smooth_library: Library, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    for is_open in (True, False):
        monkeypatch.setattr("metafab.fullwave.record.os.access", lambda *_, answer=is_open: answer)
        with pytest.raises(KeyboardInterrupt), kept_blocks(tmp_path / "answer.json", "cd" * 32, said.extend) as record:
            if not is_open:
                solve_blocks(_rows(smooth_library, 1), smooth_library, "lone", record=record)
            raise KeyboardInterrupt
    assert not list(tmp_path.iterdir())
    assert not said


def test_nothing_is_kept_beside_a_pipe() -> None:
    """Such as `/dev/stdin` and `/dev/stdout`, which resolve to names that no folder holds."""
    inner, outer = os.pipe()
    for end in (inner, outer):
        with kept_blocks(Path(f"/dev/fd/{end}"), "cd" * 32) as record:
            record.add([SolvedPoint(1, (1.0j,), 0.0, 0.0)])
        assert len(record.points) == 1
        os.close(end)


def test_solver_accuracy_and_library_make_another_record(smooth_library: Library, tmp_path: Path) -> None:
    one, other, exact = tmp_path / "one.h5", tmp_path / "other.h5", BlockNumerics(ElementNumerics(1e-4))
    one.write_bytes(b"1")
    other.write_bytes(b"2")
    usual = BlockNumerics()
    asked = (one, "rcwa", usual), (other, "rcwa", usual), (one, "meep", usual), (one, "rcwa", exact)
    assert len({blocks.inputs_of_answers(*each) for each in asked}) == 4
