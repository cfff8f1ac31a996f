"""Further names of a room's face: importable, but not listed in its ``__all__``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def further_names(face: str, names_of: Mapping[str, str]) -> Callable[[str], Any]:
    """Return the ``__getattr__`` of the package ``face`` that imports further names when they are first used.

    ``names_of`` holds the names, separated by spaces, of each module that defines them. Other names raise
    AttributeError.
    """
    module_of = {name: module for module, names in names_of.items() for name in names.split()}

    def attribute(name: str) -> Any:
        if name not in module_of:
            raise AttributeError(f"module {face!r} has no attribute {name!r}")
        return getattr(import_module(module_of[name]), name)

    return attribute
