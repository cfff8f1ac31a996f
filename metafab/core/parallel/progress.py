"""Progress as a callback: computing reports, only the command line draws."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Called as work advances; ``done`` out of ``total`` units of ``step`` are finished."""

    def __call__(self, step: str, done: float, total: float) -> None:
        """Report that ``done`` of ``total`` units of ``step`` are finished."""


def silent(step: str, done: float, total: float) -> None:
    """The default: nothing is shown."""
