"""Freed memory goes back to the system when it is asked to."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from metafab.core.parallel.measure import resident_mb
from metafab.core.parallel.memory import give_back_freed_memory

#: Arrays below the size that glibc maps separately, 160 MB in all.
COUNT, VALUES = 2000, 10_000


@pytest.mark.skipif(sys.platform != "linux", reason="glibc alone is asked")
def test_what_arrays_leave_behind_is_given_back() -> None:
    """The last array, above all others on the heap, keeps glibc from giving them back by itself."""
    arrays = [np.ones(VALUES) for _ in range(COUNT)]
    last = arrays.pop()
    arrays.clear()
    held_mb = resident_mb()
    give_back_freed_memory()
    assert held_mb - resident_mb() > 0.8 * COUNT * VALUES * 8 / 1e6
    assert last.sum() == VALUES
