"""All shapes on the sites of a lens: pillars by dose class, and the field around them, for every bias."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from metafab.core.errors import InputError
from metafab.layout import Outline, PillarMap, PillarTile
from metafab.layout.turned import outline_of
from metafab.mask.drawing.cells import Stamp, pillar_stamp
from metafab.mask.drawing.copies import Variant, biases_dbu, lens_copies, variants
from metafab.mask.drawing.dose import DoseClasses, dose_patterns
from metafab.mask.drawing.inverse import FIELD_RECTANGLES, InvertedField
from metafab.mask.shapes.hierarchy import IntArray
from metafab.spec import Design


def require_invertible(design: Design, outline: Outline | None = None) -> None:
    """Refuse (InputError) the inverted mask of pillars that are not drawn as rectangles.

    ``outline`` is that of the design by default.
    """
    drawn = Outline.of(design) if outline is None else outline
    if design.mask.tone == "inverted" and not drawn.is_rectangle:
        expected = "rectangular pillars, around which the field is rectangles"
        shape = "circle" if design.unit_cell.cell.shape == "circle" else drawn.shape
        raise InputError.single("mask", "mask.tone", expected, f"pillars of shape '{shape}'", "use 'positive'")


class Stamps:
    """The shapes on the sites of a lens, tile by tile.

    Args:
        drawn: the pillars, ``mask.bias_nm`` included.
        design: layers, dose classes, tone and copies.
        dose_class: shape (n_y, n_x) of the lattice each, dose class of each site if classes go by proximity: of each
            lens, or of one for all.

    Attributes:
        copies: the lenses.

    Raises:
        InputError: the field around these pillars cannot be inverted, or dose classes are missing or do not fit.
    """

    def __init__(self, drawn: PillarMap, design: Design, dose_class: Sequence[NDArray[np.uint8]] = ()) -> None:
        self._size_dbu = drawn.size_dbu
        self._mask = design.mask
        patterns = dose_patterns(design, dose_class)
        self.copies = lens_copies(design, patterns)
        self._variants = variants(self.copies)
        self._outline = outline_of(drawn, design)
        self._classes = {
            pattern: DoseClasses(drawn, design.mask.dose, self._outline, dose_class[pattern] if dose_class else None)
            for pattern in sorted(set(patterns)) or (0,)
        }
        self._pillars: dict[tuple[int, Variant], Stamp] = {}
        require_invertible(design, self._outline)
        inverted = design.mask.tone == "inverted"
        self._field = InvertedField(drawn, design.mask.field_layer, biases_dbu(self.copies)) if inverted else None

    def of(self, tile: PillarTile) -> Iterator[tuple[PillarTile, Stamp]]:
        """Yield size indices, and the stamp to which they refer. Safe to call from several threads."""
        for pattern, classes in self._classes.items():
            here = [variant for variant in self._variants if variant.pattern == pattern]
            for number, part in classes.split(tile):
                for variant in here:
                    yield part, self._pillar_stamp(number, variant)
        if self._field is not None:
            yield from self._field.of(tile)

    def _pillar_stamp(self, dose_class: int, variant: Variant) -> Stamp:
        """Stamp of a dose class and a variant of the lens; two threads may each compute it."""
        key = dose_class, variant
        if key not in self._pillars:
            mask = self._mask
            first = mask.datatype + variant.dose_number * mask.dose_classes
            self._pillars[key] = pillar_stamp(self._size_dbu, mask.layer, first, *key, self._outline)
        return self._pillars[key]

    def exposed(self, used: NDArray[np.int64], filled: set[tuple[int, int]]) -> int:
        """Count the exposed shapes of all copies: those of the field if it is drawn, else the pillars.

        ``used``, shape (n_sizes + 1,), is the number of sites of each size in the ``filled`` tiles, (row, column).
        """
        if self._field is None:
            return len(self.copies) * int(used[1:].sum())
        return self._field.count(used, filled, self.copies)

    def without_pillars(self, filled: set[tuple[int, int]]) -> list[tuple[int, IntArray]]:
        """(layer, rectangles of shape (n, 4)) of the field in tiles that are not among ``filled``, of every copy."""
        if self._field is None:
            return []
        return [(self._mask.field_layer, self._field.without_pillars(filled, self.copies))]


def shapes_per_pillar(design: Design) -> int:
    """Largest number of shapes that one pillar of the lens becomes in the file."""
    copies = lens_copies(design)
    drawings = len(copies) if design.mask.flat else len(variants(copies))
    return drawings * (1 + (FIELD_RECTANGLES if design.mask.tone == "inverted" else 0))
