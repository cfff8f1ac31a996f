"""One example of each command, shown at the end of its ``--help``."""

from __future__ import annotations

_RUN = "runs/helix_small"
_MASK = f"{_RUN}/layout.oas --design layouts/helix_small.toml"
_EXPOSED = f"{_RUN}/layout.oas --design layouts/helix_exposed.toml"

#: Example of each command, by its name.
EXAMPLES = {
    "new": "metafab new mylens --kind metalens",
    "run": "metafab run layouts/helix_small.toml",
    "propose": "metafab propose --range-m 0.25 0.60 --aperture-um 2000",
    "compare": "metafab compare layouts/helix_small.toml",
    "cell": "metafab cell unitcell_lib/sos_800nm.toml --width-nm 150 --length-nm 210 --target-error 1e-3",
    "library build": "metafab library build unitcell_lib/sos_800nm.toml",
    "library check": "metafab library check unitcell_lib/sos_800nm.h5 --samples 100",
    "library show": "metafab library show unitcell_lib/sos_800nm.h5",
    "library import": "metafab library import sweep.csv --unit-cell cell.toml --quantity field -o sweep.h5",
    "layout": "metafab layout layouts/helix_small.toml",
    "drc": f"metafab drc {_MASK}",
    "expose": f"metafab expose {_EXPOSED} --correct -o exposed",
    "process fit": f"metafab process fit sem.csv {_EXPOSED} -o process.toml",
    "coupling": f"metafab coupling {_MASK} --at-um 30,0",
    "patch": f"metafab patch {_MASK} --at-um 30 0 --size-um 6",
    "fullwave": "metafab fullwave blocks.json --library unitcell_lib/sos_800nm.h5 --solver rcwa",
    "psf": f"metafab psf {_MASK} --depths-m 0.0025 0.003 -o psf.h5",
    "psf import": "metafab psf import stack.tif --depths 0.25 0.3 0.35 --pixel-um 3.45 --split-um 1800 0 -o psf.h5",
    "tolerance": f"metafab tolerance {_MASK}",
    "capture": f"metafab capture layouts/helix_small.toml --psf {_RUN}/psf.h5 -o raw.h5",
    "film": f"metafab film layouts/helix_small.toml --psf {_RUN}/psf.h5 --frames 5 -o film.gif",
    "decode": f"metafab decode {_RUN}/raw.h5 --psf {_RUN}/psf.h5",
    "calibrate": "metafab calibrate point_*.tif --psf psf.h5 --depths depths.csv -o calibrated.h5",
    "stokes": "metafab stokes layouts/stokes_small.toml",
    "report": f"metafab report {_RUN}",
    "benchmark": "metafab benchmark psf --quick",
    "keys": "metafab keys mask.chip",
    "doctor": "metafab doctor",
}


def epilog(command: str) -> str:
    """The last lines of a command's help; empty without an example."""
    # The sign \b keeps click from filling the lines.
    return f"\b\nExample:\n  {EXAMPLES[command]}" if command in EXAMPLES else ""
