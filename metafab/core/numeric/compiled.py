"""Optional compilation: kernels are plain Python functions that numba compiles where it is installed.

Kernels come in pairs only where the plain form would be too slow: a vectorised NumPy function and a compiled
loop, tested against each other.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from typing import Any, TypeVar, cast

Function = TypeVar("Function", bound=Callable[..., Any])

HAS_NUMBA = find_spec("numba") is not None

#: Loop index of :func:`compiled_parallel` kernels; a plain ``range`` without numba.
prange: Any = import_module("numba").prange if HAS_NUMBA else range


def compiled(function: Function) -> Function:
    """Compile ``function`` by numba on its first call (cached on disk); without numba, return it unchanged.

    Division follows NumPy (x / 0 is infinite, nothing is raised), which lets loops with quotients be vectorised.
    """
    if not HAS_NUMBA:
        return function
    import numba

    decorated: Any = numba.njit(cache=True, nogil=True, fastmath=False, error_model="numpy")(function)
    return cast("Function", decorated)


def compiled_parallel(function: Function) -> Function:
    """As :func:`compiled`, with ``numba.prange`` loops over all threads."""
    if not HAS_NUMBA:
        return function
    import numba

    decorated: Any = numba.njit(cache=True, nogil=True, parallel=True, error_model="numpy")(function)
    return cast("Function", decorated)
