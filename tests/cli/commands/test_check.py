"""``metafab library check`` and ``drc`` as text: the figures, and the worst sizes or the first places."""

from __future__ import annotations

from metafab.cli.commands.cell import with_worst_sizes
from metafab.cli.commands.mask import with_first_places
from metafab.drc import DrcReport, Marker
from metafab.library.use.check import CheckedSize, LibraryCheck
from tests.main_job import metafab


def _check(errors: list[float]) -> LibraryCheck:
    sizes = tuple(CheckedSize(100.0 + k, 100.0, error, 1e-3, 1e-4) for k, error in enumerate(errors))
    return LibraryCheck(
        "rcwa", len(errors), max(errors), 0.0, 0.0, 0.0, 1e-3, 1e-4, 0, 0, 100.0, 100.0, 1.0, 0, "holds", sizes
    )


def test_the_text_lists_ten_sizes_the_worst_first() -> None:
    errors = [1e-4 * ((7 * k) % 25) for k in range(25)]
    shown = with_worst_sizes(_check(errors))
    assert [size.abs_error for size in shown.sizes] == sorted(errors, reverse=True)[:10]
    assert shown.samples == 25


def test_an_unknown_choice_is_refused_in_our_words() -> None:
    answer = metafab("library", "check", "none.h5", "--against", "lumerical")
    assert answer.code == 2
    assert "'lumerical' is not one of 'rcwa', 'meep'" in answer.stderr
    assert "Value error" not in answer.stderr


def test_the_text_lists_ten_places_of_each_broken_rule() -> None:
    places = {"missing": tuple(Marker(350.0 * k, 0.0, 350.0, 350.0) for k in range(25)), "grid": ()}
    report = DrcReport("mask.gds", "lattice", 0, {"missing": 25, "grid": 0}, places)
    shown = with_first_places(report)
    assert shown.markers == {"missing": places["missing"][:10], "grid": ()}
    assert shown.violations == report.violations
