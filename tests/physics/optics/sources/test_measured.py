"""Sizes from micrographs: those of the table, the bias around them elsewhere, and nothing beyond the library."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from metafab.core.errors import InputError
from metafab.layout.pillars import Lattice, PillarMap
from metafab.library import Library
from metafab.optics.sources.measured import with_measured_sizes
from metafab.optics.sources.source import made_field, written_field


@pytest.fixture
def drawn() -> PillarMap:
    """Twelve by ten pillars of two sizes, one site empty."""
    index = np.ones((10, 12), dtype=np.uint16)
    index[:, 6:] = 2
    index[3, 4] = 0
    lattice = Lattice(period_dbu=(700, 700), shape=(10, 12), database_unit_nm=0.5)
    return PillarMap.from_array(lattice, np.array([[0, 0], [240, 320], [360, 280]], dtype=np.int32), index, 64)


def _table(path: Path, *rows: tuple[float, float, float, float]) -> Path:
    path.write_text("x_um,y_um,width_nm,length_nm\n" + "".join(",".join(map(str, row)) + "\n" for row in rows))
    return path


def _at(pillars: PillarMap, row: int, column: int) -> tuple[float, float]:
    width, length = pillars.size_nm()[pillars.to_array()[row, column]]
    return float(width), float(length)


def test_measured_pillars_take_their_size_and_others_the_bias_around(
    drawn: PillarMap, smooth_library: Library, tmp_path: Path
) -> None:
    x_um, y_um = drawn.lattice.x_um(), drawn.lattice.y_um()
    # Drawn 120 x 160 and 180 x 140 nm; printed 6 nm wider and 4 nm shorter on the left, 3 nm wider on the right.
    table = _table(
        tmp_path / "sem.csv",
        (x_um[0], y_um[0], 126.0, 156.0),
        (x_um[1] + 0.05, y_um[9], 126.0, 156.0),
        (x_um[11], y_um[5], 183.0, 140.0),
    )
    made = with_measured_sizes(drawn, table, smooth_library)
    assert _at(made, 0, 0) == (126.0, 156.0)
    assert _at(made, 5, 11) == (183.0, 140.0)
    assert made.to_array()[3, 4] == 0
    wide, long = _at(made, 5, 0)
    assert 124.5 <= wide <= 126.0
    assert 156.0 <= long <= 157.5
    # Sizes off the grid have the light of the continuous library.
    light = made_field(made, smooth_library)
    place = int(made.to_array()[5, 11])
    expected = smooth_library.surface(183.0, 140.0)
    ratio = light.table[place] / np.array([expected.t_xx, expected.t_yy])
    assert np.abs(ratio - ratio[0]).max() < 1e-9


def test_a_uniform_table_changes_nothing(drawn: PillarMap, smooth_library: Library, tmp_path: Path) -> None:
    table = _table(tmp_path / "sem.csv", (drawn.lattice.x_um()[2], drawn.lattice.y_um()[2], 120.0, 160.0))
    made = with_measured_sizes(drawn, table, smooth_library)
    before, after = written_field(drawn, smooth_library), made_field(made, smooth_library)
    assert np.array_equal(before.table[drawn.to_array()], after.table[made.to_array()])


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ((0.0, 0.0, 270.0, 160.0), r"\d+ % of the pillars beyond"),
        ((90.0, 0.0, 120.0, 160.0), "1 of 1 without one"),
        ((0.0, 0.0, -5.0, 160.0), "positive sizes"),
    ],
)
def test_what_cannot_be_is_refused(
    row: tuple[float, float, float, float], message: str, drawn: PillarMap, smooth_library: Library, tmp_path: Path
) -> None:
    x_um, y_um = drawn.lattice.x_um()[7], drawn.lattice.y_um()[7]
    table = _table(tmp_path / "sem.csv", (row[0] + x_um, row[1] + y_um, *row[2:]))
    with pytest.raises(InputError, match=message):
        with_measured_sizes(drawn, table, smooth_library)


@pytest.mark.parametrize("shift_um", [(0.154, 0.0), (0.25, -0.2), (-0.35, 0.0)])
def test_a_table_that_is_shifted_is_refused_with_its_shift(
    shift_um: tuple[float, float], smooth_library: Library, tmp_path: Path
) -> None:
    """Periods of 350 nm: by 0.44 of one, 0.71 and 0.57 of one, and by a whole one."""
    index = np.random.default_rng(3).integers(1, 3, (10, 12)).astype(np.uint16)
    drawn = PillarMap.from_array(
        Lattice(period_dbu=(700, 700), shape=(10, 12), database_unit_nm=0.5),
        np.array([[0, 0], [240, 320], [360, 280]], dtype=np.int32),
        index,
        64,
    )
    x_um, y_um = drawn.lattice.x_um(), drawn.lattice.y_um()
    rows = [(x, y, *_at(drawn, j, i)) for j, y in enumerate(y_um) for i, x in enumerate(x_um)][13:-13]
    kept = [row for row in rows if max(abs(row[0]), abs(row[1])) < 1.5]
    table = _table(tmp_path / "sem.csv", *((x + shift_um[0], y + shift_um[1], w, z) for x, y, w, z in kept))
    x, y = shift_um
    with pytest.raises(InputError, match=rf"shifted by \({x:g}, {y:g}\) um.*subtract \({x:g}, {y:g}\)"):
        with_measured_sizes(drawn, table, smooth_library)


def test_a_table_without_a_column_is_refused(drawn: PillarMap, smooth_library: Library, tmp_path: Path) -> None:
    path = tmp_path / "sem.csv"
    path.write_text("x_um,y_um,cd_nm\n0,0,120\n")
    with pytest.raises(InputError, match="no column width_nm"):
        with_measured_sizes(drawn, path, smooth_library)
