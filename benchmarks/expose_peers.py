"""Proximity-effect correction by pecpy (doi 10.1016/j.mee.2018.07.013) on one field.

The program runs in an interpreter that has pecpy (``benchmarks/expose_peers.txt``), without metafab. It reads one JSON
object from stdin, ``{"design": image.npy, "range_px": r, "threshold": eta, "dose": output.npy}``, writes the dose of
each pixel, and prints ``{"seconds": s, "processor_seconds": s, "peak_rss_mb": mb}``. Settings are those of the
package's example, with its filter at a pixel and a half, which resolves edges.
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


def main() -> None:
    """Correct the field of the job on stdin."""
    job = json.load(sys.stdin)
    design = np.load(job["design"])
    betas = [2.0**power for power in range(13)]
    solver = LBFGSB(5e-7, 1e8 * np.finfo(float).eps, 50)
    start, busy = time.perf_counter(), time.process_time()
    found = optimize_dose(design, job["range_px"], job["threshold"], betas, FilterProjectionStepper(1.5, [0.5]), solver)
    cost = {"seconds": time.perf_counter() - start, "processor_seconds": time.process_time() - busy}
    np.save(job["dose"], found["dose"])
    print(json.dumps({**cost, "peak_rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3}))


if __name__ == "__main__":
    main()
