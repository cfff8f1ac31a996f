"""A cited refractive index: a dispersion formula or a table, its range and its source."""

from __future__ import annotations

import cmath
import csv
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from metafab.core.errors import InputError
from metafab.core.storage.files import require_file
from metafab.core.storage.limits import require_modest_table

#: Complex index for x and y polarisation.
IndexPair = tuple[complex, complex]

_HEADER = ("wavelength_nm", "n", "k")


@dataclass(frozen=True)
class IndexRecord:
    """A cited refractive index."""

    name: str  #: Such as ``"Si/Schinke"``.
    citation: str  #: Source of the numbers and the sample.
    range_nm: tuple[float, float]  #: Shortest and longest vacuum wavelength of the source.
    #: n + ik for x and y polarisation, as a function of the vacuum wavelength in nm inside the range.
    index: Callable[[float], IndexPair]

    def at(self, wavelength_nm: float) -> IndexPair:
        """Complex index for x and y polarisation; a wavelength outside the range of the source raises InputError."""
        low, high = self.range_nm
        if not low <= wavelength_nm <= high:
            expected, got = f"{low:g} to {high:g} nm, the range of {self.citation}", f"{wavelength_nm:g} nm"
            remedy = "take a record that covers it, or give `n` and `k`"
            raise InputError.single(f"material record {self.name}", "wavelength_nm", expected, got, remedy)
        return self.index(wavelength_nm)


def isotropic(index: Callable[[float], complex]) -> Callable[[float], IndexPair]:
    """Return the index of an isotropic material: equal for both polarisations."""
    return biaxial(index, index)


def biaxial(x: Callable[[float], complex], y: Callable[[float], complex]) -> Callable[[float], IndexPair]:
    """Return the index of a material with different indices for x and y polarisation."""
    return lambda wavelength_nm: (x(wavelength_nm), y(wavelength_nm))


def sellmeier(terms: Iterable[tuple[float, float]]) -> Callable[[float], complex]:
    """Sellmeier formula n^2 = 1 + sum of B lambda^2 / (lambda^2 - C^2), lambda and C in micrometres; lossless."""
    poles = tuple((strength, pole**2) for strength, pole in terms)

    def index(wavelength_nm: float) -> complex:
        square_um2 = (wavelength_nm * 1e-3) ** 2
        return cmath.sqrt(1.0 + sum(b * square_um2 / (square_um2 - c) for b, c in poles))

    return index


def read_table(path: Path, name: str) -> IndexRecord:
    """Read a record from a CSV file with the columns ``wavelength_nm,n,k``, linear between its rows.

    Lines that begin with ``#`` are comments; the first of them is the citation. A missing file, or rows that are not
    increasing wavelengths with n > 0 and k >= 0, raise InputError.
    """
    expected = "a CSV file with the header wavelength_nm,n,k and rows of increasing wavelength, n > 0, k >= 0"

    def refuse(got: str, remedy: str = "correct the file") -> InputError:
        return InputError.single(str(path), "file", expected, got, remedy)

    require_file(path, expected)
    try:
        require_modest_table(path)
        lines = path.read_text(encoding="utf-8-sig").splitlines()
        numbers = [number for number, line in enumerate(lines, 1) if line.strip() and not line.startswith("#")]
        rows = list(csv.reader(lines[number - 1] for number in numbers))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise refuse(f"an unreadable file ({error})") from error
    comments = [line.lstrip("# ").strip() for line in lines if line.startswith("#")]
    if not rows or tuple(cell.strip() for cell in rows[0]) != _HEADER:
        raise refuse(f"the header {','.join(rows[0])}" if rows else "no rows")
    try:
        table = np.array([[float(cell) for cell in row] for row in rows[1:]])
    except ValueError as error:
        raise refuse(f"a cell that is no number ({error})") from error
    if table.ndim != 2 or table.shape[1] != len(_HEADER):
        raise refuse("rows that do not hold three numbers each")
    wavelength_nm, n, k = table.T
    sound = np.isfinite(table).all(axis=1) & (n > 0) & (k >= 0)
    if not sound.all():
        first = int(sound.argmin())
        raise refuse(f"the values {', '.join(rows[1 + first])} in line {numbers[1 + first]}")
    if not (rises := np.diff(wavelength_nm) > 0).all():
        first = int(rises.argmin())
        got = f"{wavelength_nm[first + 1]:g} nm after {wavelength_nm[first]:g} nm in line {numbers[2 + first]}"
        raise refuse(got, "sort the rows by wavelength, each once")

    def index(at_nm: float) -> complex:
        return complex(np.interp(at_nm, wavelength_nm, n), np.interp(at_nm, wavelength_nm, k))

    citation = comments[0] if comments else f"the file {path.name}"
    return IndexRecord(name, citation, (float(wavelength_nm[0]), float(wavelength_nm[-1])), isotropic(index))
