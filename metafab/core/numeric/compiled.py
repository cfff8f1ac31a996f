"""Compilation of numerical kernels by numba, cached on disk."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numba.extending

Function = TypeVar("Function", bound=Callable[..., Any])


def inlined(function: Function) -> Function:
    """Let kernels inline ``function``; called from Python, it is not compiled and takes NumPy arrays."""
    numba.extending.register_jitable(function)
    return function


def compiled(function: Function) -> Function:
    """Compile ``function`` on its first call.

    Division follows NumPy (x / 0 is infinite, nothing is raised), which lets loops with quotients be vectorised. The
    interpreter lock is released, so that :func:`metafab.core.parallel.executor.spread` can run parts of a loop in
    threads: numba's own parallel loops take three times as long to compile.
    """
    return cast("Function", numba.njit(cache=True, nogil=True, fastmath=False, error_model="numpy")(function))
