"""The entry point: errors and interrupts become one clear message and an exit code."""

from __future__ import annotations

import os
import sys

from metafab.cli.app import app
from metafab.cli.arguments import spread_depths
from metafab.core.errors import MetafabError
from metafab.core.parallel.interrupts import InterruptedRunError, raised_interrupts

# Each adds its commands, in the order that --help shows.
# isort: off
from metafab.cli.commands import whole  # noqa: F401
from metafab.cli.commands import propose  # noqa: F401
from metafab.cli.commands import cell  # noqa: F401
from metafab.cli.commands import mask  # noqa: F401
from metafab.cli.commands import fullwave  # noqa: F401
from metafab.cli.commands import light  # noqa: F401
from metafab.cli.commands import stokes  # noqa: F401
from metafab.cli.commands import compare  # noqa: F401
from metafab.cli.commands import showing  # noqa: F401

# isort: on

#: How many threads a library of linear algebra starts.
_ALGEBRA_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def main() -> None:
    """Run the command line and translate errors into one clear message and an exit code."""
    for name in _ALGEBRA_THREADS:
        # Our matrices are small and our processes many: a second thread waits in a loop for more than it computes.
        os.environ.setdefault(name, "1")
    # Threads of compiled loops that wait in a loop of their own take the cores from the work beside them.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    try:
        with raised_interrupts():
            app(spread_depths(sys.argv[1:]))
    except MetafabError as error:
        print(f"metafab: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    except InterruptedRunError:
        print("metafab: interrupted; nothing half-written was left behind", file=sys.stderr)
        sys.exit(1)
    except (OSError, MemoryError) as error:
        print(f"metafab: {type(error).__name__}: {error}", file=sys.stderr)
        sys.exit(1)
