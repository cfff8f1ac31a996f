"""The command line: one thin function for each command.

Exit codes: 0 done; 1 failed; 2 bad input or violated rules; 130 Ctrl-C; 143 SIGTERM. With ``--json``, stdout holds one
JSON object and nothing else. Progress bars go to stderr, and only on a terminal.

- ``again``      answer of an unchanged run
- ``entry``      entry point: errors and interrupts become a message and an exit code
- ``failures``   failures from outside as one message
- ``app``        the program, and the options shared by several commands
- ``outputs``    places of results, checked before the work
- ``headlines``  most important figures of a run
- ``console``    bars, tables, JSON
- ``commands``   the commands:

  - ``run``       ``new``, ``run``, ``stokes``
  - ``cell``      ``cell``, ``library build``, ``library check``, ``library import``, ``library show``
  - ``mask``      ``layout``, ``drc``
  - ``expose``    ``expose``, ``process fit``
  - ``fullwave``  ``fullwave``, ``coupling``, ``patch``
  - ``light``     ``psf``, ``psf import``, ``tolerance``
  - ``images``    ``capture``, ``film``, ``decode``, ``calibrate``
  - ``study``     ``propose``, ``compare``
  - ``service``   ``report``, ``benchmark``, ``keys``, ``doctor``
"""

import gc
import sys

from metafab.cli.again import answer_again

__all__ = ["main"]

#: New objects between two searches for cycles: 700, Python's own number, costs a run 5 % and numba's compiler 10 %.
_COLLECTED_AT = 20_000


def main() -> None:
    """Run the command line; an unchanged run is answered before the program is imported."""
    code = answer_again(sys.argv[1:])
    if code is None:
        gc.set_threshold(_COLLECTED_AT)
        from metafab.cli import entry

        try:
            entry.main()
        finally:
            # The interpreter's end would search all objects of a run for cycles, for 0.6 s.
            gc.freeze()
    sys.exit(code)
