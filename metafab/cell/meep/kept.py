"""Finished runs on disk, each under the hash of all that decides it: what a kill cannot take back."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path

import numpy as np

from metafab.cell.meep.protocol import Job, Reply
from metafab.core.storage.files import fingerprint, whole_file

#: Names the folder of finished runs; empty keeps none.
VARIABLE = "METAFAB_MEEP_JOBS"


class KeptReplies:
    """Replies of finished jobs, one .npz file each. Any number of processes may share the folder.

    Args:
        folder: where they are; made when the first one is kept.
        program: what ran the jobs (worker's source, version of Meep): another program's replies are not ours.
    """

    def __init__(self, folder: Path, program: str) -> None:
        self._folder = folder
        self._program = program

    def find(self, job: Job) -> Reply | None:
        """The reply of an equal job, if one has finished. A damaged file counts as none, and is replaced."""
        try:
            with np.load(self._path(job), allow_pickle=False) as content:
                return {name: np.array(content[name]) for name in content.files}
        except (OSError, ValueError, EOFError, zipfile.BadZipFile):
            return None

    def keep(self, job: Job, reply: Reply) -> None:
        """Keep a reply, whole or not at all."""
        with whole_file(self._path(job)) as part, part.open("wb") as stream:
            np.savez(stream, **reply)  # type: ignore[arg-type]

    def _path(self, job: Job) -> Path:
        return self._folder / f"{fingerprint(self._program, job)[:40]}.npz"


def own_folder() -> Path | None:
    """Where this user's finished runs are: ``METAFAB_MEEP_JOBS``, or ``metafab/meep`` among the user's caches."""
    named = os.environ.get(VARIABLE)
    if named is not None:
        return Path(named) if named else None
    caches = os.environ.get("XDG_CACHE_HOME")
    return (Path(caches) if caches else Path.home() / ".cache") / "metafab" / "meep"
