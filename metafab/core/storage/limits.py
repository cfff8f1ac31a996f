"""Limits on what reading one file may take, checked before anything is expanded.

A few bytes can state billions of shapes or terabytes of zeros. Each reader has its own default, mostly by the size of
the file. A design's ``[limits]`` replace it for its masks, and in a run for all that the steps read; the option
``--limit`` replaces it for all readers. Stated limits hold in their thread (more exactly, in its ``contextvars``
context), so that threads that read under unlike limits do not mix them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from types import MappingProxyType
from typing import Literal, TypeAlias

from metafab.core.errors import InputError

#: Memory of what a file expands to; shapes with all placements; nesting of cells; processor time, estimated by records.
LimitName: TypeAlias = Literal["memory_mb", "shapes", "depth", "seconds"]

_NONE: Mapping[str, float] = MappingProxyType({})
_stated: ContextVar[Mapping[str, float]] = ContextVar("_stated", default=_NONE)


def limit(name: LimitName, default: float) -> float:
    """The limit that is stated where this is called, or ``default``."""
    return _stated.get().get(name, default)


@contextmanager
def limited(**stated: float | None) -> Iterator[None]:
    """State limits for all files that are read in the block; limits of an outer block have precedence.

    A thread that is started in the block begins without them, unless it runs in a copy of the context
    (``contextvars.copy_context().run``).

    Args:
        stated: limits by :data:`LimitName`; None for the default of each reader.
    """
    token = _stated.set({name: value for name, value in stated.items() if value is not None} | dict(_stated.get()))
    try:
        yield
    finally:
        _stated.reset(token)


def require_modest_table(path: Path) -> None:
    """Refuse (InputError) a table in text whose lines and cells would take more memory as lists than ``memory_mb``.

    By default 512 MB for a file of up to 10 MB, and 64 bytes more for each byte of a larger one; OSError if it cannot
    be read.
    """
    size = path.stat().st_size
    most_mb = limit("memory_mb", _TABLE_MB + 64e-6 * max(0.0, size - 1e7))
    taken = 0
    with path.open("rb") as stream:
        while part := stream.read(1 << 20):
            taken += sum(each * part.count(sign) for sign, each in _BYTES_OF_A_SIGN.items())
    if taken > 1e6 * most_mb:
        expected, got = f"at most {most_mb:.0f} MB of lines and cells", f"{1e-6 * taken:.0f} MB"
        raise beyond(str(path), "file", "memory_mb", expected, got, "give fewer rows")


#: Default memory of a table's lists (MB), and bytes that each separator of lines or cells adds to them.
_TABLE_MB = 512.0
_BYTES_OF_A_SIGN = {b"\n": 512, b"\r": 512, b"\v": 512, b"\f": 512, b",": 64, b";": 64, b"\t": 64, b" ": 64}


def beyond(
    source: str, field: str, name: LimitName, most: str, got: str, remedy: str = "", *, by_design: bool = True
) -> InputError:
    """Return the error of a file that exceeds a limit.

    Args:
        source: the file.
        field: part of the file at fault.
        name: the limit.
        most: what the file may have, such as "at most 64 MB of arrays".
        got: what it has.
        remedy: what to do instead; by default, to raise the limit for a file that is to be trusted.
        by_design: whether a design can raise it; it cannot for a file that is read before the design, or without one.
    """
    key = f"`limits.{name}` of the design, or " if by_design else ""
    raising = f"raise {key}`--limit {name}=N`, if you trust the file"
    return InputError.single(source, field, most, got, f"{remedy}; or {raising}" if remedy else raising)
