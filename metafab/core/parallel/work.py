"""Workers, cluster and progress callback of a long computation."""

from __future__ import annotations

from concurrent.futures import Executor
from contextlib import AbstractContextManager
from dataclasses import dataclass

from metafab.core.parallel.executor import open_executor, open_threads
from metafab.core.parallel.progress import Progress, silent


@dataclass(frozen=True)
class Work:
    """Resources of long work, passed down unchanged from the command line."""

    workers: int | None = None  #: Processes or threads; None for all cores.
    cluster: str | None = None  #: Address of a Dask scheduler, or None for this machine.
    progress: Progress = silent  #: Callback of long work.

    def processes(self) -> AbstractContextManager[Executor]:
        """Open an executor over processes of this machine, or over the cluster; errors as :func:`open_executor`."""
        return open_executor(self.workers, self.cluster, self.progress)

    def threads(self) -> AbstractContextManager[Executor]:
        """Open an executor over threads of this process, or over the cluster."""
        return open_threads(self.workers, self.cluster, self.progress)
