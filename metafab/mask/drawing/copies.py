"""Several lenses on one chip: place, bias and dose of each copy, and which copy a rectangle of a file belongs to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from metafab.core.errors import InputError
from metafab.layout import lattice_of
from metafab.layout.geometry import aperture_dbu, whole_dbu
from metafab.mask.shapes.hierarchy import IntArray
from metafab.spec import Design


@dataclass(frozen=True, order=True)
class Variant:
    """Properties of a lens that its cells depend on; copies with equal ones share their cells."""

    bias_dbu: int = 0  #: Added to the drawn width and length, on top of ``mask.bias_nm``.
    dose_number: int = 0  #: Number of its dose among those of all copies, ascending, from 0.
    pattern: int = 0  #: Number from 0 of its map of dose classes, among the different maps of all copies.

    @property
    def tag(self) -> str:
        """Suffix of cell names, short enough for 32 characters; empty without a bias, at the first dose and pattern."""
        sign = "P" if self.bias_dbu > 0 else "M"
        if not self.dose_number and not self.pattern:
            return f"_{sign}{abs(self.bias_dbu):05d}" if self.bias_dbu else ""
        parts = ((sign, abs(self.bias_dbu)), ("E", self.dose_number), ("K", self.pattern))
        return "_" + "".join(f"{letter}{number}" for letter, number in parts if number)


#: A lens without a bias, at the first dose and pattern.
PLAIN = Variant()


@dataclass(frozen=True)
class LensCopy:
    """One lens of the chip."""

    x_dbu: int  #: x of its optical axis.
    y_dbu: int  #: y of its optical axis.
    variant: Variant = PLAIN  #: Bias and dose.
    label: str | None = None  #: Text drawn above it; None for nothing.


def lens_copies(design: Design, patterns: Sequence[int] = ()) -> tuple[LensCopy, ...]:
    """Return the lenses in the order of ``mask.copies``; a single one in the middle if none are listed.

    ``patterns`` number their maps of dose classes; one map for all by default.

    InputError if a place is not a whole, or a bias not an even, number of database units, or two lenses overlap.
    """
    unit_nm = design.mask.database_unit_nm
    copies: list[LensCopy] = []
    for number, copy in enumerate(design.mask.copies):
        key = f"mask.copies[{number}]"
        x_dbu, y_dbu = (whole_dbu(at_um * 1e3, unit_nm, f"{key}.at_um") for at_um in copy.at_um)
        bias_dbu = whole_dbu(copy.bias_nm, unit_nm, f"{key}.bias_nm", even=True)
        for other, before in enumerate(copies):
            if max(abs(x_dbu - before.x_dbu), abs(y_dbu - before.y_dbu)) < aperture_dbu(design):
                expected = f"at least {design.device.aperture_um:g} um from `mask.copies[{other}]`, along x or along y"
                raise InputError.single(design.name, f"{key}.at_um", expected, f"{copy.at_um}", "move it")
        variant = Variant(bias_dbu, design.mask.doses.index(copy.dose), patterns[number] if patterns else 0)
        copies.append(LensCopy(x_dbu, y_dbu, variant, copy.label))
    return tuple(copies) or (LensCopy(0, 0),)


def lens_copy(design: Design, number: int) -> LensCopy:
    """Return copy ``number``, counted from 1; InputError if there is no such copy."""
    copies = lens_copies(design)
    if not 1 <= number <= len(copies):
        raise InputError.single(design.name, "copy", f"1 to {len(copies)}", str(number), "see `mask.copies`")
    return copies[number - 1]


def variants(copies: Sequence[LensCopy]) -> tuple[Variant, ...]:
    """Distinct biases and doses in rising order; each has its own cells."""
    return tuple(sorted({copy.variant for copy in copies}))


def biases_dbu(copies: Sequence[LensCopy]) -> tuple[int, ...]:
    """Distinct biases in rising order."""
    return tuple(sorted({copy.variant.bias_dbu for copy in copies}))


class OtherCopies:
    """Removes and counts the rectangles of all copies but one.

    Args:
        design: the chip.
        number: the copy whose rectangles are wanted, counted from 1.
        unit_ratio: file unit in database units of the design.

    Attributes:
        counts: rectangles in the lattice square of every other copy, by its number.
    """

    def __init__(self, design: Design, number: int, unit_ratio: Fraction) -> None:
        lattice, ratio = lattice_of(design), float(unit_ratio)
        self._half = np.array(lattice.shape[::-1]) * lattice.period_dbu / 2.0 / ratio
        self._centres = {
            other: np.array([copy.x_dbu, copy.y_dbu]) / ratio
            for other, copy in enumerate(lens_copies(design), start=1)
            if other != number
        }
        self.counts = dict.fromkeys(self._centres, 0)

    def apart(self, rectangles: IntArray, shift: IntArray) -> tuple[IntArray, dict[int, IntArray]]:
        """Divide rectangles by their centres: those in no other copy, and those of each other copy that has any.

        Rectangles (x, y, width, height), shape (n, 4) and (m, 4), are in file units and not shifted; ``shift``, shape
        (2,), is to be added to x and y.
        """
        found: dict[int, IntArray] = {}
        if not self._centres or not len(rectangles):
            return rectangles, found
        centre = rectangles[:, :2] + rectangles[:, 2:] / 2.0 + shift
        low, high = centre.min(axis=0), centre.max(axis=0)
        kept = np.ones(len(rectangles), dtype=bool)
        for number, middle in self._centres.items():
            if np.all(low <= middle + self._half) and np.all(high >= middle - self._half):
                here = np.all(np.abs(centre - middle) <= self._half, axis=1)
                found[number] = rectangles[here]
                self.counts[number] += len(found[number])
                kept &= ~here
        return (rectangles if kept.all() else rectangles[kept]), found
