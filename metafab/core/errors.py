"""What can go wrong, and with which exit code: input and rules 2, everything else 1.

A fault names the field, what was expected, what came, and what to do. All faults of one file travel together.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong with an input.

    Where several fields do not go together, ``expected`` is the whole sentence, naming them, and ``got`` is empty;
    ``field`` is the table that they stand in, empty for the file itself.
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
    """Base of every error that metafab raises on purpose; the command line exits with ``exit_code``."""

    exit_code = 1


class InputError(MetafabError):
    """A file, an option or an argument cannot be used.

    Args:
        source: the file or command-line option at fault.
        faults: everything that is wrong with it.
    """

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


class RulesViolatedError(MetafabError):
    """A layout breaks its design rules."""

    exit_code = 2


class SolverError(MetafabError):
    """A solver could not give a trustworthy answer."""


class MissingToolError(MetafabError):
    """An optional program or package is not installed; the message says how to get it."""
