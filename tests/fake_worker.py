"""Fake workers that behave as told, in place of Meep."""

from __future__ import annotations

from collections.abc import Callable

from metafab.cell.meep.protocol import Job

#: Starts a fake worker that behaves like the given lines.
Fake = Callable[[str], list[str]]


#: Start of every fake worker: it notes its process, and writes arrays for each job.
PRELUDE = """
import json, os, subprocess, sys, time
import numpy as np
def say(**message):
    print(json.dumps(message), flush=True)
open(f"{sys.argv[0]}.{os.getpid()}", "w").close()
for line in sys.stdin:
    message = json.loads(line)
    name, job, arrays = message["id"], message["job"], message["arrays"]
    np.savez(arrays, answer=np.array([job["n_x"], os.getpid()]))
"""


#: Behaviour of a worker that reports and ends.
HONEST = """
    say(id=name, progress=1.5)
    say(id=name, done=True, seconds=0.0)
"""


def small_job(n_x: int = 2) -> Job:
    """A job that no worker simulates, told apart by ``n_x``."""
    one = (1.0 + 0.0j,) * 3
    return Job(
        pixel_um=0.1,
        n_x=n_x,
        n_y=2,
        n_z=40,
        absorber_nodes=8,
        source_node=11,
        monitor_nodes=(14, 28),
        wavelength_um=1.0,
        polarisation="x",
        components=("x",),
        orders=((0, 0),),
        weight=(1.0, 1.0),
        epsilon_in=one,
        blocks=(),
        smooth=False,
        mirrors=(),
        decay=1e-3,
        longest_time=10.0,
    )
