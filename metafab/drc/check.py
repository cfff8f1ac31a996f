"""A written file against the rules of its design, by any engine."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from metafab.core.errors import InputError
from metafab.core.parallel.progress import Progress
from metafab.core.parallel.work import Work
from metafab.drc.lattice import check_lattice
from metafab.drc.rectangles import check_rectangles
from metafab.drc.report import DrcReport
from metafab.mask import ReadBack, read
from metafab.spec import Design


def check(
    path: Path | str,
    design: Design,
    *,
    engine: str = "lattice",
    work: Work = Work(),
    copy: int = 1,
    reader: Callable[[Path, Design, Progress, int], ReadBack] = read,
) -> DrcReport:
    """Check a GDSII or OASIS file; nothing but the file is read.

    Args:
        design: rules, lattice, aperture, layer.
        engine: ``lattice`` checks every rule exactly, on the sites of the design; ``rectangles`` takes rectangles of
            any lattice; ``polygons`` is KLayout's (MissingToolError without it) and takes any shapes. The last two
            check width, aspect ratio, gap, overlap, grid and foreign shapes.
        work: threads, progress, and a cluster, whose workers check bands of rows (``lattice``) or rows of tiles
            (``polygons``; they must find the file at the same path). ``rectangles`` is one stream and runs here.
        copy: lens of ``mask.copies`` that ``lattice`` checks, counted from 1; the others are counted. The two engines
            without a lattice check all of them.
        reader: reads the file for ``lattice``; :func:`metafab.mask.read_shared` where later steps need it, too.

    Raises:
        InputError: the file cannot be read as a mask, or the engine is unknown.
    """
    start, path = time.perf_counter(), Path(path)
    if engine == "lattice":
        report = check_lattice(reader(path, design, work.progress, copy), design, work)
    elif engine == "rectangles":
        report = check_rectangles(path, design, work)
    elif engine == "polygons":
        from metafab.drc.polygons import check_polygons

        report = check_polygons(path, design, work)
    else:
        raise InputError.single("--engine", "engine", "'lattice', 'rectangles' or 'polygons'", repr(engine))
    return replace(report, seconds=time.perf_counter() - start)
