"""Compilation of numerical kernels by numba, cached on disk."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])

#: Loop index of :func:`compiled_parallel` kernels.
prange: Any = numba.prange


def compiled(function: Function) -> Function:
    """Compile ``function`` on its first call.

    Division follows NumPy (x / 0 is infinite, nothing is raised), which lets loops with quotients be vectorised.
    """
    return cast("Function", numba.njit(cache=True, nogil=True, fastmath=False, error_model="numpy")(function))


def compiled_parallel(function: Function) -> Function:
    """Compile ``function`` on its first call, with :data:`prange` loops over all threads."""
    return cast("Function", numba.njit(cache=True, nogil=True, parallel=True, error_model="numpy")(function))
