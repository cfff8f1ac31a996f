"""Hostile files: masks by grammar (valid records, hostile values), all other formats by mutation of whole files.

A file is determined by its format and its seed.
"""

from __future__ import annotations

import random
import struct
import zlib
from collections.abc import Callable, Mapping

from metafab.mask.gdsii import records as gds
from metafab.mask.oasis.elements import signed, string, unsigned

#: Values at which readers overflow, round, or allocate.
_EDGES = (
    0,
    1,
    2,
    3,
    127,
    128,
    255,
    2**15 - 1,
    2**15,
    2**16,
    2**28,
    2**31 - 1,
    2**31,
    2**32,
    2**40,
    2**53,
    2**62,
    2**63,
)
#: Bytes of the elements of a cell of many records: four such cells stay below 10 MB.
_MOST_BYTES = 2_400_000
_EDGES_SMALL = (0, 1, 2, 7, 32767, -1, -32768)
_REALS = (0.0, -0.0, 1.0, 1e3, 1e-3, 2e3, 5e-324, 1e308, -1.0, float("inf"), float("nan"))
_NAMES = ("A", "B", "C", "TOP", "", "A" * 300, "x y")
#: Bytes that mean much in text and tables.
_TOKENS = (
    b"\0", b"\xff", b"\xef\xbb\xbf", b"1e999", b"nan", b"-1", b"0", b"9" * 400, b"inf", b"[", b"]", b"{", b"=", b"'",
    b'"', b"\\u0000", b"\n", b".", b"a." * 40, b"[[" * 50, b"\xff\xff\xff\x7f", b"\xff" * 7 + b"\x7f", b"../" * 5,
)  # fmt: skip


class Mask:
    """Random masks.

    Args:
        seed: seed of the file.
        most_bytes: size to which elements of some cells are repeated, up to a million times; 0 for no repetition.
    """

    def __init__(self, seed: int, most_bytes: int = 0) -> None:
        self._most_bytes = most_bytes
        self._random = random.Random(seed)
        # Files with many hostile values are refused at the first; those with few reach deeper code.
        self._hostility = self._random.choice((0.0, 0.01, 0.03, 0.1, 0.3))

    def _hostile(self) -> bool:
        return self._random.random() < self._hostility

    def _whole(self) -> int:
        """A whole number from 0: one that a mask could hold, or a hostile one."""
        draw = self._random
        if not self._hostile():
            return draw.choice((0, 1, 2, 5, 200, 250, 700, draw.randrange(5000)))
        return max(0, draw.choice(_EDGES) + draw.randrange(-2, 3))

    def _signed(self) -> int:
        return self._whole() * self._random.choice((1, 1, -1))

    def _repeated(self, body: bytes) -> bytes:
        """The elements of a cell, many times where the file is a large one."""
        if not self._most_bytes or not body:
            return body
        return body * min(10 ** self._random.randrange(7), self._most_bytes // len(body))

    # OASIS

    def oasis(self) -> bytes:
        """An OASIS file."""
        draw = self._random
        start = b"\x01" + string(draw.choice(("2.0", "")) if self._hostile() else "1.0") + self._unit() + b"\x01"
        if self._hostile():
            start = start[:-1] + b"\0" + b"".join(unsigned(self._whole()) for _ in range(12))
        tables = b"".join(
            bytes([draw.choice((3, 5, 7, 9))]) + string(draw.choice(_NAMES)) for _ in range(draw.randrange(3))
        )
        cells = [self._cell(k) for k in range(draw.randrange(1, 5))]
        end = b"\x02" + b"\x00" * 12
        return b"%SEMI-OASIS\r\n" + start + tables + b"".join(cells) + end + b"\x00" * (256 - len(end))

    def _unit(self) -> bytes:
        draw = self._random
        if not self._hostile():
            return b"\x00" + unsigned(draw.choice((1000, 2000)))
        return draw.choice((
            b"\x07" + struct.pack("<d", draw.choice(_REALS)), b"\x06" + struct.pack("<f", 2000.0),
            b"\x04" + unsigned(self._whole()) + unsigned(self._whole()), b"\x02" + unsigned(self._whole()),
        ))  # fmt: skip

    def _cell(self, number: int) -> bytes:
        draw = self._random
        name = draw.choice(_NAMES) if self._hostile() else f"C{number}"
        head = b"\x0d" + unsigned(self._whole()) if self._hostile() else b"\x0e" + string(name)
        body = self._repeated(b"".join(self._element(number) for _ in range(draw.randrange(8))))
        if body and draw.random() < 0.15:
            packer = zlib.compressobj(9, zlib.DEFLATED, -15)
            packed = packer.compress(body) + packer.flush()
            size = self._whole() if self._hostile() else len(body)
            return head + b"\x22\x00" + unsigned(size) + unsigned(len(packed)) + packed
        return head + body

    def _element(self, number: int) -> bytes:
        draw = self._random
        common, odd = (0, 15, 16, 17, 17, 17, 18, 19, 20, 20, 20, 20, 20, 28), (21, 22, 23, 24, 25, 26, 27, 29, 32, 33)
        kind = draw.choice(odd if self._hostile() else common)
        if kind in (0, 15, 16, 29):
            return bytes([kind])
        if kind in (17, 18):
            return self._placement(kind, number)
        if kind == 28:
            return b"\x1c" + bytes([0x04 | draw.choice((0, 0x10, 0xF0))]) + string("p") + self._property()
        info = draw.randrange(256)
        if not self._hostile():
            info = (0x5B if kind == 19 else 0x7B) | draw.choice((0, 0x04))
        fields = {
            19: ((0x40, self._text), (0x01, unsigned), (0x02, unsigned), (0x10, signed), (0x08, signed)),
            20: (*((bit, unsigned) for bit in (0x01, 0x02, 0x40, 0x20)), (0x10, signed), (0x08, signed)),
        }.get(kind)
        if fields is None:
            content = b"".join(
                draw.choice((unsigned(self._whole()), self._points())) for _ in range(draw.randrange(1, 6))
            )
            return bytes([kind, info]) + content + (self._repetition() if info & 0x04 else b"")
        content = b"".join(
            encode(self._signed() if encode is signed else 1 if bit == 0x01 and not self._hostile() else self._whole())
            for bit, encode in fields
            if info & bit
        )
        return bytes([kind, info]) + content + (self._repetition() if info & 0x04 else b"")

    def _text(self, value: int) -> bytes:
        return string(self._random.choice(_NAMES)) if value % 3 else unsigned(value)

    def _property(self) -> bytes:
        draw = self._random
        return draw.choice(
            (b"\x08" + unsigned(self._whole()), b"\x0a" + string("v"), b"\x07" + bytes(8), bytes([draw.randrange(256)]))
        )

    def _placement(self, kind: int, number: int) -> bytes:
        draw = self._random
        target = f"C{draw.randrange(4)}" if self._hostile() else f"C{max(0, number - 1)}"
        info = 0xB0 | (draw.randrange(8) if draw.random() < 0.3 else 0) | draw.choice((0, 0x08))
        reals = b""
        if kind == 18:
            for bit in (0x04, 0x02):
                if info & bit:
                    reals += b"\x07" + struct.pack("<d", draw.choice(_REALS) if self._hostile() else 90.0)
        repeated = self._repetition() if info & 0x08 else b""
        return bytes([kind, info]) + string(target) + reals + signed(self._signed()) + signed(self._signed()) + repeated

    def _points(self) -> bytes:
        draw = self._random
        count = self._whole() if self._hostile() else draw.randrange(6)
        form = draw.randrange(7)
        return bytes([form]) + unsigned(count) + b"".join(unsigned(self._whole()) for _ in range(min(count, 6)))

    def _repetition(self) -> bytes:
        draw = self._random
        form = draw.randrange(13) if self._hostile() else draw.randrange(1, 12)
        columns, rows = (self._whole() if self._hostile() else draw.randrange(20) for _ in range(2))
        steps = [unsigned(self._whole()) for _ in range(2 + min(columns, 50))]
        if form in (1, 8):
            return bytes([form]) + unsigned(columns) + unsigned(rows) + b"".join(steps[:4])
        if form in (2, 3, 9):
            return bytes([form]) + unsigned(columns) + steps[0] + steps[1]
        if form in (5, 7, 11):
            return bytes([form]) + unsigned(columns) + unsigned(draw.choice((1, 700, self._whole()))) + b"".join(steps)
        return bytes([form]) + unsigned(columns) + b"".join(steps)

    # GDSII

    def gdsii(self) -> bytes:
        """A GDSII file."""
        draw = self._random
        times = struct.pack(">12h", *(draw.choice(_EDGES_SMALL) for _ in range(12)))
        units = gds.real(1e-3) + gds.real(draw.choice((1e-12, 1e-30, 1e30)) if self._hostile() else 5e-10)
        if self._hostile():
            units = draw.randbytes(16)
        head = gds.record(gds.HEADER, b"\x02\x58") + gds.record(gds.BGNLIB, times)
        head += gds.record(gds.LIBNAME, b"L\0") + gds.record(gds.UNITS, units)
        cells = []
        for number in range(draw.randrange(1, 5)):
            name = draw.choice(_NAMES) if self._hostile() else f"C{number}"
            body = self._repeated(b"".join(self._of_structure(number) for _ in range(draw.randrange(8))))
            cells.append(
                gds.record(gds.BGNSTR, times) + gds.record(gds.STRNAME, gds.text(name)) + body + gds.record(gds.ENDSTR)
            )
        return head + b"".join(cells) + gds.record(gds.ENDLIB)

    def _of_structure(self, number: int) -> bytes:
        draw = self._random
        kind = draw.choice(
            (gds.BOUNDARY,) * 4 + (gds.SREF,) * 2 + (gds.AREF,) * 2 + (gds.PATH, gds.TEXT, gds.NODE, gds.BOX)
        )
        fields = b""
        if kind in (gds.SREF, gds.AREF):
            target = f"C{draw.randrange(4)}" if self._hostile() else f"C{max(0, number - 1)}"
            fields += gds.record(gds.SNAME, gds.text(target))
            if self._hostile():
                fields += gds.record(gds.STRANS, struct.pack(">H", draw.choice((0, 0x8000, 2, 4, 0xFFFF))))
                fields += gds.record(gds.MAG, draw.choice((gds.real(1.0), gds.real(1e20), bytes(8), b"\xff" * 8)))
                fields += gds.record(gds.ANGLE, draw.choice((gds.real(90.0), gds.real(45.0), bytes(8), b"\xff" * 8)))
            if kind == gds.AREF:
                columns, rows = (draw.choice(_EDGES_SMALL if self._hostile() else (1, 3, 20)) for _ in range(2))
                fields += gds.record(gds.COLROW, struct.pack(">2h", columns, rows))
            points = 3 if kind == gds.AREF else 1
        else:
            layer = draw.choice(_EDGES_SMALL) if self._hostile() else 1
            fields += gds.record(gds.LAYER, struct.pack(">h", layer)) + gds.record(gds.DATATYPE, b"\0\0")
            if kind == gds.PATH:
                fields += gds.record(gds.WIDTH, struct.pack(">i", self._coordinate()))
            points = draw.choice((5, 5, 5, 1, 2, 4, 200))
        if kind == gds.BOUNDARY and draw.random() < 0.6:
            x, y, w, h = (self._coordinate() for _ in range(4))
            corners = [x, y, x + w, y, x + w, y + h, x, y + h, x, y]
            numbers = [max(-(2**31), min(2**31 - 1, value)) for value in corners]
        else:
            numbers = [self._coordinate() for _ in range(2 * points)]
        xy = gds.record(gds.XY, struct.pack(f">{len(numbers)}i", *numbers))
        return gds.record(kind) + fields + xy + gds.record(gds.ENDEL)

    def _coordinate(self) -> int:
        return max(-(2**31), min(2**31 - 1, self._signed()))


def mutated(whole: bytes, seed: int) -> bytes:
    """Mutation of a whole file by up to 16 changes: bits, numbers, tokens, and blocks that are lost or repeated."""
    draw, data = random.Random(seed), bytearray(whole)
    for _ in range(draw.choice((1, 1, 2, 4, 16))):
        at = draw.randrange(max(len(data), 1))
        # Heads hold the sizes: half of all changes hit the first KB.
        at = at % 1024 if draw.random() < 0.5 else at
        kind = draw.randrange(7)
        if kind == 0 and data:
            at = min(at, len(data) - 1)
            data[at] ^= 1 << draw.randrange(8)
        elif kind == 1:
            data[at : at + 4] = struct.pack(draw.choice(("<I", ">I")), draw.choice(_EDGES) & 0xFFFFFFFF)
        elif kind == 2:
            data[at : at + 8] = struct.pack("<Q", draw.choice(_EDGES))
        elif kind == 3:
            token = draw.choice(_TOKENS)
            data[at : at + draw.choice((0, len(token)))] = token
        elif kind == 4:
            del data[at : at + draw.choice((1, 4, 64, 4096))]
        elif kind == 5:
            block = data[at : at + draw.choice((1, 16, 512))]
            data[at:at] = block * draw.choice((1, 2, 50))
        else:
            del data[at:]
    return bytes(data)


def maker(kind: str, whole: Mapping[str, bytes]) -> Callable[[int], bytes]:
    """Return the function from a seed to a hostile file of ``kind``, a file suffix.

    Args:
        kind: "gds" and "oas" by grammar, one in four of them mutated besides, "many.gds" and "many.oas" with many
            records; another suffix by mutation.
        whole: whole files by suffix.
    """

    def by_grammar(seed: int) -> bytes:
        mask = Mask(seed, _MOST_BYTES if kind.startswith("many.") else 0)
        data = mask.oasis() if kind.endswith("oas") else mask.gdsii()
        return mutated(data, seed) if seed % 4 == 0 else data

    return by_grammar if kind.endswith(("gds", "oas")) else lambda seed: mutated(whole[kind], seed)
