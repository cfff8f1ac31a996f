"""OASIS integers: seven bits a byte, the least significant first, the top bit set on all but the last."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metafab.core.numeric.compiled import compiled

TokenArray = NDArray[np.uint64]
ByteArray = NDArray[np.uint8]


def unsigned(value: int) -> bytes:
    """One unsigned integer."""
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def signed(value: int) -> bytes:
    """One signed integer: magnitude shifted left, the sign in bit 0."""
    return unsigned(abs(value) << 1 | (value < 0))


def string(text: str) -> bytes:
    """A length and the characters."""
    data = text.encode("ascii")
    return unsigned(len(data)) + data


def encode_vectorised(tokens: TokenArray) -> bytes:
    """Many unsigned integers, one after the other; shape (n,). One pass for each byte of the longest."""
    length = np.ones(tokens.size, dtype=np.int64)
    for power in range(7, 70, 7):
        longer = tokens >> np.uint64(power) if power < 64 else np.zeros_like(tokens)
        if not longer.any():
            break
        length += longer > 0
    end = np.cumsum(length)
    out = np.empty(int(end[-1]) if tokens.size else 0, dtype=np.uint8)
    start = end - length
    for byte in range(int(length.max(initial=0))):
        has = np.flatnonzero(length > byte)
        more = (length[has] > byte + 1).astype(np.uint8) << np.uint8(7)
        out[start[has] + byte] = (tokens[has] >> np.uint64(7 * byte)).astype(np.uint8) & np.uint8(0x7F) | more
    return out.tobytes()


@compiled
def put(out: ByteArray, position: int, value: int) -> int:
    """Write an unsigned integer at ``position``; returns the position behind it."""
    while value >= 0x80:
        out[position] = value & 0x7F | 0x80
        value >>= 7
        position += 1
    out[position] = value
    return position + 1


@compiled
def put_signed(out: ByteArray, position: int, value: int) -> int:
    """Write a signed integer at ``position``; returns the position behind it."""
    return put(out, position, abs(value) << 1 | (value < 0))
