"""Proximity-effect correction by pecpy (doi 10.1016/j.mee.2018.07.013) on one field.

The program runs in an interpreter that has pecpy (``benchmarks/exposure/expose_peers.txt``), without metafab. It reads
one JSON object from stdin, ``{"design": image.npy, "range_px": r, "threshold": eta, "dose": output.npy}``, writes the
dose of each pixel, and prints ``{"seconds": s, "processor_seconds": s, "peak_rss_mb": mb}``. Settings are those of the
package's example, except for its filter, which at a pixel and a half resolves edges, and its tolerances: those of the
example end the search at its start, because the gradient falls with the number of pixels.
"""

from __future__ import annotations

import json
import resource
import sys
import time
import types

import numpy as np
import scipy

if not hasattr(scipy, "misc"):
    # Of the removed module, pecpy uses only functions that read and write pictures.
    scipy.misc = sys.modules["scipy.misc"] = types.ModuleType("misc")  # type: ignore[assignment]

from pecpy.core import LBFGSB, FilterProjectionStepper, optimize_dose


class _Flat:
    """The package's solver with the start as a vector, which newer versions of scipy require."""

    def __init__(self, solver: LBFGSB) -> None:
        self._solver = solver

    def __getattr__(self, name: str) -> object:
        return getattr(self._solver, name)

    def solve(self, x0: np.ndarray, stepper: object) -> np.ndarray:
        """Minimise from ``x0``, an image."""
        return np.reshape(self._solver.solve(x0.reshape(-1), stepper), x0.shape)


def main() -> None:
    """Correct the field of the job on stdin."""
    job = json.load(sys.stdin)
    design = np.load(job["design"])
    betas = [2.0**power for power in range(13)]
    solver = _Flat(LBFGSB(1e-11, 1e3 * np.finfo(float).eps, 50))
    start, busy = time.perf_counter(), time.process_time()
    found = optimize_dose(design, job["range_px"], job["threshold"], betas, FilterProjectionStepper(1.5, [0.5]), solver)
    cost = {"seconds": time.perf_counter() - start, "processor_seconds": time.process_time() - busy}
    np.save(job["dose"], found["dose"])
    print(json.dumps({**cost, "peak_rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3}))


if __name__ == "__main__":
    main()
