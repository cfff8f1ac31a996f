"""metafab: from unit cell to mask to decoded image.

The rooms, in the order in which data flows:

- ``spec``       design, unit-cell and scene files (TOML) -> frozen specs
- ``materials``  refractive indices from cited records
- ``cell``       one unit cell -> Jones t and r, with an error
- ``library``    a sweep over width and length -> Library
- ``phase``      target phases of both polarisations -> PhaseProfile
- ``layout``     PhaseProfile + Library + rules -> PillarMap
- ``mask``       PillarMap -> GDSII / OASIS, and back from the file
- ``drc``        design rules on a written file
- ``optics``     PillarMap + Library -> Psf
- ``fullwave``   pieces of a written mask by full-wave solvers, against the library
- ``camera``     scene + Psf -> raw frame
- ``decode``     raw frame + Psf -> Image4D
- ``report``     figures and the HTML page
- ``run``        all of it, skipping what is up to date

The conventions stand in :mod:`metafab.core.conventions`.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.2.0"

_ROOMS = (
    "spec", "materials", "cell", "library", "phase", "layout", "mask",
    "drc", "optics", "fullwave", "camera", "decode", "report", "run",
)  # fmt: skip

__all__ = ["__version__"]


def __getattr__(name: str) -> Any:
    """Rooms are imported when first used: ``import metafab`` stays fast."""
    if name in _ROOMS:
        return import_module(f"metafab.{name}")
    raise AttributeError(f"module 'metafab' has no attribute {name!r}")
