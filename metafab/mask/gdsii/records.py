"""Records of GDSII: length, kind (record and data type), data; whole numbers are big-endian."""

from __future__ import annotations

import math
import struct

HEADER, BGNLIB, LIBNAME, UNITS, ENDLIB = 0x0002, 0x0102, 0x0206, 0x0305, 0x0400
BGNSTR, STRNAME, ENDSTR = 0x0502, 0x0606, 0x0700
BOUNDARY, PATH, SREF, AREF, TEXT, NODE, BOX = 0x0800, 0x0900, 0x0A00, 0x0B00, 0x0C00, 0x1500, 0x2D00
LAYER, DATATYPE, XY, ENDEL, SNAME, COLROW = 0x0D02, 0x0E02, 0x1003, 0x1100, 0x1206, 0x1302
WIDTH, STRANS, MAG, ANGLE, PATHTYPE = 0x0F03, 0x1A01, 0x1B05, 0x1C05, 0x2102
TEXTTYPE, STRING = 0x1602, 0x1906

# DATATYPE, TEXTTYPE, NODETYPE and BOXTYPE.
DATATYPES = {DATATYPE, TEXTTYPE, 0x2A02, 0x2E02}
PROPERTIES = {0x2B02, 0x2C06}
# All records allowed in an element; the second line: flags, extensions of paths, presentation and string of texts.
IN_ELEMENTS = {LAYER, XY, SNAME, COLROW, WIDTH, STRANS, MAG, ANGLE, PATHTYPE} | DATATYPES | PROPERTIES
IN_ELEMENTS |= {0x2601, 0x2F03, 0x3003, 0x3103, 0x1701, STRING}
# All records allowed between elements.
BETWEEN_ELEMENTS = {HEADER, BGNLIB, LIBNAME, UNITS, ENDLIB, BGNSTR, STRNAME, ENDSTR}
BETWEEN_ELEMENTS |= {0x1F06, 0x2006, 0x2202, 0x2306, 0x3202, 0x3302, 0x3401, 0x3602, 0x3706, 0x3800, 0x3902, 0x3A06}
BETWEEN_ELEMENTS |= {0x3B02}


def record(kind: int, data: bytes = b"") -> bytes:
    """Encode a record."""
    return struct.pack(">HH", len(data) + 4, kind) + data


def text(value: str) -> bytes:
    """Encode a string, padded to whole words."""
    data = value.encode("ascii")
    return data + b"\0" * (len(data) % 2)


def real(value: float) -> bytes:
    """Encode a positive 8-byte real: exponent of 16 in excess 64, mantissa of 56 bits."""
    exponent = 64
    while value >= 1.0:
        value /= 16.0
        exponent += 1
    while value < 1.0 / 16.0:
        value *= 16.0
        exponent -= 1
    mantissa = round(value * 2.0**56)
    return struct.pack(">Q", exponent << 56 | mantissa)


def read_real(data: bytes) -> float:
    """Decode an 8-byte real; 0 for data of another length."""
    if len(data) != 8:
        return 0.0
    (word,) = struct.unpack(">Q", data)
    value = math.ldexp(word & (1 << 56) - 1, 4 * ((word >> 56 & 0x7F) - 64) - 56)
    return -value if word >> 63 else value
