"""Errors with their exit codes: 2 for bad input and violated rules, 1 for failures.

A fault names the field, the expected value, the value found, and the remedy. One error carries all faults of a file.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass(frozen=True)
class Fault:
    """One fault of an input.

    If several fields contradict each other, ``expected`` holds the whole sentence, ``got`` is empty, and ``field`` is
    the table that contains them (empty for the file itself).
    """

    field: str
    expected: str
    got: str
    remedy: str = ""

    def __str__(self) -> str:
        if not self.got:
            return f"`{self.field}`: {self.expected}" if self.field else self.expected
        text = f"`{self.field}`: expected {self.expected}, got {self.got}"
        return f"{text}; {self.remedy}" if self.remedy else text


class MetafabError(Exception):
    """Base class of metafab's own errors; the command line exits with ``exit_code``."""

    exit_code = 1


class InputError(MetafabError):
    """An unusable file, option or argument (``source``), with all of its faults."""

    exit_code = 2

    def __init__(self, source: str, faults: Iterable[Fault]) -> None:
        self.source = source
        self.faults = tuple(faults)
        super().__init__("\n".join([f"{source}:", *(f"  {fault}" for fault in self.faults)]))

    @classmethod
    def single(cls, source: str, field: str, expected: str, got: str, remedy: str = "") -> InputError:
        """An error with one fault."""
        return cls(source, [Fault(field, expected, got, remedy)])

    def __reduce__(self) -> tuple[type[InputError], tuple[str, tuple[Fault, ...]]]:
        """Keep the faults when the error crosses a process boundary."""
        return (type(self), (self.source, self.faults))


class SpecError(InputError, ValueError):
    """Unusable values of a spec that Python makes by itself; a ValueError, too."""


class SolverError(MetafabError):
    """A solver reached no trustworthy answer."""


class WorkerLostError(MetafabError):
    """One after another, ``losses`` worker processes died on ``piece``, the function and arguments of one call."""

    def __init__(self, piece: str, losses: int) -> None:
        self.piece, self.losses = piece, losses
        super().__init__(
            f"{losses} worker processes ended, one after another, on {piece}; memory is the usual reason: use fewer "
            "`--workers`, and run it again to go on from what is kept"
        )

    def __reduce__(self) -> tuple[type[WorkerLostError], tuple[str, int]]:
        """Keep the piece when the error crosses a process boundary."""
        return (type(self), (self.piece, self.losses))


class ClusterLostError(MetafabError):
    """The Dask scheduler at ``address`` went away during the work."""

    def __init__(self, address: str) -> None:
        self.address = address
        super().__init__(
            f"the Dask scheduler at {address} is gone; finished steps and solved cells are kept: start it again, or "
            "leave `--cluster` out, and run it again to go on from there"
        )

    def __reduce__(self) -> tuple[type[ClusterLostError], tuple[str]]:
        """Keep the address when the error crosses a process boundary."""
        return (type(self), (self.address,))


class MissingToolError(MetafabError):
    """A missing optional program or package; the message says how to install it."""


@contextmanager
def noted(work: str) -> Iterator[None]:
    """Add to every exception of the block a note of the work that it ended, such as "step `layout`"."""
    try:
        yield
    except Exception as error:
        error.add_note(work)
        raise
