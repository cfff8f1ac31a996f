"""A real Dask scheduler and two worker processes on loopback."""

from __future__ import annotations

from typing import Any

import pytest


def two_workers() -> Any:
    """A context with them; its value is the cluster, whose ``scheduler_address`` commands take.

    The scheduler's page takes any free port: with a fixed one, a second cluster on this machine would warn.
    The connect timeout, 30 s by default, is how long a worker waits for one that died just before it fetched from it.
    """
    distributed = pytest.importorskip("distributed")
    return distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        config={"distributed.comm.timeouts.connect": "5s"},
    )
