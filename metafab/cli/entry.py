"""The entry point: errors and interrupts become one clear message and an exit code."""

from __future__ import annotations

import os
import signal
import sys
from typing import TYPE_CHECKING, NoReturn

from metafab.cli.app import app
from metafab.cli.arguments import spread_depths
from metafab.core.errors import MetafabError

# Each adds its commands, in the order that --help shows.
# isort: off
from metafab.cli import whole, propose, cell, mask, fullwave, light, stokes, compare, showing  # noqa: F401

# isort: on

if TYPE_CHECKING:
    from types import FrameType


#: How many threads a library of linear algebra starts.
_ALGEBRA_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


class _InterruptedError(BaseException):
    """Ctrl-C or SIGTERM: unwinds everything, so that half-written files are removed; nobody swallows it."""


def _interrupt(number: int, frame: FrameType | None) -> NoReturn:
    raise _InterruptedError


def main() -> None:
    """Run the command line and translate errors into one clear message and an exit code."""
    for name in _ALGEBRA_THREADS:
        # Our matrices are small and our processes many: a second thread waits in a loop for more than it computes.
        os.environ.setdefault(name, "1")
    # Threads of compiled loops that wait in a loop of their own take the cores from the work beside them.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    before = {number: signal.signal(number, _interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        app(spread_depths(sys.argv[1:]))
    except MetafabError as error:
        print(f"metafab: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    except _InterruptedError:
        print("metafab: interrupted; nothing half-written was left behind", file=sys.stderr)
        sys.exit(1)
    except (OSError, MemoryError) as error:
        print(f"metafab: {type(error).__name__}: {error}", file=sys.stderr)
        sys.exit(1)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
