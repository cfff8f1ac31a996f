"""Checks of a library with solvers in closed form: requests to the solver, and the verdict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab import library
from metafab.cell import CellNumerics, CellResponse, PillarCell
from metafab.core.errors import InputError
from metafab.library import Library
from tests import library_ridges as ridges


class _Biased:
    """The library's own values off by ``bias``, with a stated error; remembers what it was asked."""

    def __init__(self, bias: complex, error: float) -> None:
        self.bias, self.error = bias, error
        self.asked: list[CellNumerics] = []

    def __call__(self, cell: PillarCell, numerics: CellNumerics) -> CellResponse:
        self.asked.append(numerics)
        true = ridges.solve(cell, numerics)
        return replace(true, t=true.t + self.bias * np.eye(2), error=self.error)


@pytest.fixture
def stored(smooth_library: Library) -> Library:
    """The ridges at three widths and lengths, too few to go on between them: samples are stored sizes."""
    width_nm, length_nm = smooth_library.width_nm[::30], smooth_library.length_nm[::30]
    t_xx = np.vectorize(ridges.amplitude)(*np.meshgrid(width_nm, length_nm))[None]
    t_yy, error = t_xx.transpose(0, 2, 1), np.full(t_xx.shape, 1e-3)
    return replace(
        smooth_library, width_nm=width_nm, length_nm=length_nm, t_xx=t_xx, t_yy=t_yy, r_xx=t_xx, r_yy=t_yy, error=error
    )


def test_a_check_by_meep_asks_for_what_meep_can_do(stored: Library) -> None:
    judge = _Biased(0.004, 5e-3)
    found = library.check(stored, against="meep", samples=7, solver=judge)
    assert {numerics.solver for numerics in judge.asked} == {"meep"}
    assert {numerics.target_error for numerics in judge.asked} == {1e-2}
    assert (found.samples, len(found.sizes), found.verdict) == (7, 7, "holds")
    assert found.max_abs_error == pytest.approx(0.004)
    assert found.mean_abs_error == pytest.approx(0.004)
    assert (found.max_stated_error, found.max_solver_error) == pytest.approx((1e-3, 5e-3))
    finer = _Biased(0.0, 0.0)
    library.check(stored, against="rcwa", samples=2, solver=finer)
    assert {n.target_error for n in finer.asked} == {0.1 * stored.unit_cell.sweep.target_error}


def test_a_check_names_every_size_and_the_worst(stored: Library) -> None:
    found = library.check(stored, against="meep", samples=9, solver=_Biased(0.02j, 1e-3))
    assert (found.verdict, found.beyond_stated) == ("fails", 9)
    assert all(size.abs_error > size.stated_error + size.solver_error for size in found.sizes)
    worst = max(found.sizes, key=lambda size: size.abs_error)
    assert worst.abs_error == found.max_abs_error
    assert 0.0 < found.mean_phase_error_rad <= found.max_phase_error_rad
    # A bias of 0.02 turns an amplitude of a tenth, the smallest that counts, by 0.2 at most.
    assert found.max_phase_error_rad < 0.21


def test_a_check_that_is_none_says_so(stored: Library) -> None:
    """The finer solve ended where the library did: a difference of zero, which proves nothing."""
    idle = library.check(stored, against="rcwa", samples=9, solver=_Biased(0.0, 1e-3))
    assert (idle.verdict, idle.not_checked, idle.max_abs_error) == ("no check", 9, pytest.approx(0.0))
    assert "9 of 9 samples are not checked" in idle.warnings()[0]
    finer = library.check(stored, against="rcwa", samples=9, solver=_Biased(0.0, 1e-4))
    assert (finer.verdict, finer.not_checked, finer.warnings()) == ("holds", 0, [])
    # Another solver is a check whatever its error.
    other = library.check(stored, against="meep", samples=9, solver=_Biased(0.0, 1e-2))
    assert (other.verdict, other.not_checked) == ("holds", 0)


def test_a_bound_that_excludes_nothing_is_no_check(stored: Library) -> None:
    """A stated error of 1.1 holds for any amplitude."""
    loose = replace(stored, error=np.where(np.arange(3) < 2, 1.1, 1e-3) * np.ones_like(stored.error))
    found = library.check(loose, against="meep", samples=9, solver=_Biased(0.004, 5e-3))
    assert (found.verdict, found.vacuous) == ("holds", 6)
    (sentence,) = found.warnings()
    assert "6 of 9 samples have bounds that together are 0.5 or more (library: at most 1.1, meep: 0.005)" in sentence
    # The bound that excludes nothing may be that of the solver alone.
    unsure = library.check(stored, against="meep", samples=9, solver=_Biased(0.004, 0.6))
    assert (unsure.verdict, unsure.vacuous) == ("no check", 9)
    assert "(library: at most 0.001, meep: 0.6)" in unsure.warnings()[0]
    all_loose = replace(stored, error=np.full_like(stored.error, 1.1))
    assert library.check(all_loose, against="meep", samples=9, solver=_Biased(0.004, 5e-3)).verdict == "no check"
    # What is off by more than even such a bound fails.
    assert library.check(all_loose, against="meep", samples=9, solver=_Biased(1.5, 5e-3)).verdict == "fails"


def test_a_check_needs_a_sample(stored: Library) -> None:
    with pytest.raises(InputError, match="`samples`: expected 1 or more, got 0"):
        library.check(stored, samples=0)
