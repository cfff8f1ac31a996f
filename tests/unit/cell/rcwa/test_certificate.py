"""The sequence of truncations that the certified solver tries."""

from __future__ import annotations

from metafab.cell import CellNumerics
from metafab.cell.rcwa.certificate import ladder


def test_seven_cosines_are_tried_only_where_nothing_was_measured() -> None:
    """Pillars that six cosines did not serve go on to eight, unless seven are all that may be had."""
    assert ladder(CellNumerics(1e-3), measured=True)[:4] == (4, 6, 8, 9)
    assert ladder(CellNumerics(1e-3))[:5] == (4, 5, 6, 7, 8)
    assert ladder(CellNumerics(1e-2))[:4] == (3, 4, 5, 6) and ladder(CellNumerics(1e-2), measured=True)[:3] == (3, 5, 6)
    assert ladder(CellNumerics(1e-3, max_orders=7), measured=True) == (4, 6, 7)
