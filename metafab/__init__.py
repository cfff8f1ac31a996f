"""metafab: metasurfaces from unit cell to mask to decoded image.

Rooms, in the order in which data flows:

- ``spec``         design, unit-cell and scene files (TOML) -> frozen specs
- ``materials``    refractive indices from cited records
- ``cell``         one unit cell -> Jones t and r, with an error
- ``library``      a sweep over width and length -> Library
- ``phase``        target phases of both polarisations -> PhaseProfile
- ``layout``       PhaseProfile + Library + rules -> PillarMap
- ``mask``         PillarMap -> GDSII / OASIS, and back from the file
- ``drc``          design rules on a written file
- ``exposure``     electron exposure: printed sizes, doses corrected for proximity effects
- ``optics``       PillarMap + Library -> Psf
- ``information``  Fisher information and Cramér-Rao bounds of depth
- ``fullwave``     full-wave simulations of parts of a written mask
- ``camera``       scene + Psf -> raw frame
- ``decode``       raw frame + Psf -> Image4D
- ``comparison``   depth and sharpness compared with other cameras
- ``tolerance``    effect of fabrication errors
- ``steps``        steps of the pipeline, and the summary of a run
- ``report``       figures and the HTML page
- ``run``          the whole pipeline; steps that are up to date are skipped

Conventions: :mod:`metafab.core.conventions`.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.2.0"

_ROOMS = (
    "spec",
    "materials",
    "cell",
    "library",
    "phase",
    "layout",
    "mask",
    "drc",
    "exposure",
    "optics",
    "information",
    "fullwave",
    "camera",
    "decode",
    "comparison",
    "tolerance",
    "steps",
    "report",
    "run",
)

__all__ = ["__version__"]


def __getattr__(name: str) -> Any:
    """Import a package when it is first used, so that ``import metafab`` stays fast."""
    if name in _ROOMS:
        return import_module(f"metafab.{name}")
    raise AttributeError(f"module 'metafab' has no attribute {name!r}")
