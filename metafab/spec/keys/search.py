"""All keys by kind of file, and search by a part of a name."""

from __future__ import annotations

from functools import cache

from metafab.core.errors import InputError
from metafab.spec.cell import UnitCell
from metafab.spec.design import Design
from metafab.spec.keys.reference import Key, keys_of, near


@cache
def files() -> dict[str, tuple[Key, ...]]:
    """Return the keys of each kind of file: "design", "unit cell"; a scene file holds the design's ``scene`` keys."""
    design = [key for key in keys_of(Design) if not key.path.startswith("unit_cell")]
    return {"design": tuple(design), "unit cell": keys_of(UnitCell)}


def search(place: str) -> tuple[Key, ...]:
    """Return the keys whose path contains ``place``; InputError if there is none."""
    keys = [key for group in files().values() for key in group]
    found = tuple(key for key in keys if place.lower() in key.path.lower())
    if not found:
        names = {name.removesuffix("[]") for key in keys for name in (key.path, *key.path.split("."))}
        raise InputError.single("keys", "KEY", "part of a key", repr(place), near(place, sorted(names)))
    return found
