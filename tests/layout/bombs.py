"""Small OASIS files whose compressed blocks expand to much."""

from __future__ import annotations

import zlib

from metafab.mask.oasis.elements import signed, string, unsigned
from metafab.mask.oasis.writer import CBLOCK, CELL, END, END_BYTES, MAGIC, START

LISTS = ("corners", "places")


def list_in_a_block(kind: str, count: int, layer: int) -> bytes:
    """A polygon of ``count`` corners, or a trapezoid at ``count`` places: some bytes a thousand of them."""
    heads = {
        "corners": bytes([21, 0b11_1011]) + unsigned(layer) + b"\0" + unsigned(0) + unsigned(count),
        "places": bytes([23, 0b111_1111])
        + unsigned(layer)
        + b"\0"
        + unsigned(9) * 2
        + bytes(4)
        + b"\4"
        + unsigned(count),
    }
    return _file(heads[kind] + b"\2" * (count + 1) + signed(0) * 2)


def records_in_a_block(count: int, layer: int) -> bytes:
    """``count`` rectangles of two bytes each."""
    return _file(
        bytes([20, 0b111_1011]) + unsigned(layer) + b"\0" + unsigned(9) * 2 + bytes(2) + bytes([20, 0]) * count
    )


def _file(content: bytes) -> bytes:
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    packed = packer.compress(content) + packer.flush()
    block = bytes([CBLOCK, 0]) + unsigned(len(content)) + unsigned(len(packed)) + packed
    head = MAGIC + bytes([START]) + string("1.0") + b"\0" + unsigned(2000) + bytes(13)
    return head + bytes([CELL]) + string("A") + block + bytes([END]) + bytes(END_BYTES - 1)
