"""A user's table of refractive indices."""

from __future__ import annotations

from pathlib import Path

import pytest

from metafab.core.errors import InputError
from metafab.materials import refractive_index
from metafab.spec import Material


def _index(record: str, wavelength_nm: float) -> complex:
    return refractive_index(Material(record=record), wavelength_nm)[0]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])  # spreadsheets begin a file with a byte-order mark
def test_a_users_table(encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "film.csv"
    text = "# our ellipsometer\nwavelength_nm,n,k\n700,3.8,0.02\n900,3.6,0.0\n"
    path.write_text(text, encoding=encoding)
    assert _index(str(path), 750.0) == pytest.approx(3.75 + 0.015j, abs=1e-12)
    with pytest.raises(InputError, match="our ellipsometer"):
        _index(str(path), 901.0)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "nm,n,k\n700,3.8,0\n",
        "wavelength_nm,n,k\n",
        "wavelength_nm,n,k\n900,3.6,0\n700,3.8,0\n",
        "wavelength_nm,n,k\n700,3.8,-0.1\n",
        "wavelength_nm,n,k\n700,nan,0\n",
        "wavelength_nm,n,k\n700,3.8\n",
        "wavelength_nm,n,k\n700,3.8,zero\n",
        "wavelength_nm,n,k\n700,3.8," + 200_000 * "0" + "\n",
        "wavelength_nm,n,k\n" + 1_100_000 * "7\n",
    ],
)
def test_a_bad_table_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "film.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=r"film\.csv"):
        _index(str(path), 800.0)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("900,3.6,0\n700,3.8,0\n", "got 700 nm after 900 nm in line 4; sort the rows"),
        ("700,3.8,0\n700,3.8,0\n", "got 700 nm after 700 nm in line 4"),
        ("700,3.8,0\n750,3.7,-0.1\n", "got the values 750, 3.7, -0.1 in line 4"),
        ("700,nan,0\n", "got the values 700, nan, 0 in line 3"),
    ],
)
def test_a_bad_row_is_shown(tmp_path: Path, rows: str, message: str) -> None:
    path = tmp_path / "film.csv"
    path.write_text("# measured\nwavelength_nm,n,k\n" + rows)
    with pytest.raises(InputError, match=message):
        _index(str(path), 800.0)
    with pytest.raises(InputError, match="got no file at that path; check the path"):
        _index(str(tmp_path / "none.csv"), 800.0)
