"""The command line: one thin function a step, and the only place that draws bars and exits.

Exit codes: 0 done; 1 failed; 2 bad input or rules violated. With ``--json``, stdout holds one JSON object and
nothing else; progress goes to stderr, and only on a terminal.

- ``entry``      the entry point: errors and interrupts become a message and an exit code
- ``app``        the program, and the options that several commands take
- ``arguments``  what the shell hands over, made into what the options take
- ``console``    bars, tables, JSON
- ``headlines``  a run in a dozen lines

and the commands, by what they make:

- ``whole``      ``new``, ``run``
- ``cell``       ``cell``, ``library build``, ``library check``, ``library show``
- ``mask``       ``layout``, ``drc``
- ``fullwave``   ``coupling``, ``patch``
- ``light``      ``psf``, ``tolerance``, ``capture``, ``film``, ``decode``, ``calibrate``
- ``stokes``     ``stokes``
- ``showing``    ``report``, ``benchmark``, ``doctor``
"""

from metafab.cli.app import app
from metafab.cli.entry import main

__all__ = ["app", "main"]
