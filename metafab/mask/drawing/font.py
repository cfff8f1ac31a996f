"""Capital letters, digits and a few signs as rectangles: five by seven squares per character."""

from __future__ import annotations

import numpy as np

from metafab.core.errors import InputError
from metafab.mask.shapes.hierarchy import IntArray

#: Rows and columns of a character; an empty column follows.
ROWS, COLUMNS = 7, 5

# Seven rows from the top, two hexadecimal digits each; the leftmost square is the highest of five bits.
_GLYPHS = {
    "0": "0e11131519110e", "1": "040c040404040e", "2": "0e11010204081f", "3": "1f02040201110e",
    "4": "02060a121f0202", "5": "1f101e0101110e", "6": "0608101e11110e", "7": "1f010204080808",
    "8": "0e11110e11110e", "9": "0e11110f01020c", "A": "0e1111111f1111", "B": "1e11111e11111e",
    "C": "0e11101010110e", "D": "1c12111111121c", "E": "1f10101e10101f", "F": "1f10101e101010",
    "G": "0e11101711110f", "H": "1111111f111111", "I": "0e04040404040e", "J": "0702020202120c",
    "K": "11121418141211", "L": "1010101010101f", "M": "111b1515111111", "N": "11111915131111",
    "O": "0e11111111110e", "P": "1e11111e101010", "Q": "0e11111115120d", "R": "1e11111e141211",
    "S": "0f10100e01011e", "T": "1f040404040404", "U": "1111111111110e", "V": "11111111110a04",
    "W": "1111111515150a", "X": "11110a040a1111", "Y": "1111110a040404", "Z": "1f01020408101f",
    "-": "0000001f000000", "_": "0000000000001f", ".": "00000000000c0c", "+": "0004041f040400",
    "/": "01010204081010", " ": "00000000000000",
}  # fmt: skip


def width_squares(text: str) -> int:
    """Width of ``text`` in squares."""
    return max(0, len(text) * (COLUMNS + 1) - 1)


def text_rectangles(text: str, square: int) -> IntArray:
    """Draw ``text`` in one line from (0, 0) to the right, in capitals, of squares with the side ``square``.

    A run of squares along x is one rectangle (x, y, width, height), shape (n, 4), and no two rectangles overlap.
    InputError if the font lacks a character.
    """
    unknown = sorted(set(text.upper()) - set(_GLYPHS))
    if unknown:
        expected = "letters, figures, spaces and - _ . + /"
        raise InputError.single("mask.chip", "label", expected, f"{unknown[0]!r}", "leave it out")
    rectangles = []
    for place, character in enumerate(text.upper()):
        for row, bits in enumerate(bytes.fromhex(_GLYPHS[character])):
            inked = np.array([0, *(bits >> column & 1 for column in reversed(range(COLUMNS))), 0])
            edges = np.flatnonzero(np.diff(inked))
            for start, end in edges.reshape(-1, 2):
                rectangles.append((place * (COLUMNS + 1) + start, ROWS - 1 - row, end - start, 1))
    return np.array(rectangles, dtype=np.int64).reshape(-1, 4) * square
