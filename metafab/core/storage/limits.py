"""Limits on what reading one file may take, spent before anything is expanded.

A few bytes can state billions of shapes or terabytes of zeros. Each reader has its own default, mostly by the size of
the file. A design's ``[limits]`` replace it for its masks, and in a run for all that the steps read; the option
``--limit`` replaces it for all readers.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal, TypeAlias

from metafab.core.errors import InputError

#: Memory of what a file expands to; shapes with all placements; nesting of cells; processor time, estimated by records.
LimitName: TypeAlias = Literal["memory_mb", "shapes", "depth", "seconds"]

_STATED: dict[str, float] = {}


def limit(name: LimitName, default: float) -> float:
    """The stated limit of this process, or ``default``."""
    return _STATED.get(name, default)


@contextmanager
def limited(**stated: float | None) -> Iterator[None]:
    """State limits for all files that are read in the block; what is stated around the block already has precedence.

    Args:
        stated: limits by :data:`LimitName`; None for the default of each reader.
    """
    added = {name: value for name, value in stated.items() if value is not None and name not in _STATED}
    _STATED.update(added)
    try:
        yield
    finally:
        for name in added:
            del _STATED[name]


def beyond(
    source: str, field: str, name: LimitName, most: str, got: str, remedy: str = "", *, by_design: bool = True
) -> InputError:
    """The error of a file that goes beyond a limit.

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
