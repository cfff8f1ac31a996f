"""A written file against the rules of its design, by either engine."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

from metafab.core.errors import InputError
from metafab.core.parallel.progress import Progress, silent
from metafab.drc.lattice import check_lattice
from metafab.drc.rectangles import check_rectangles
from metafab.drc.report import DrcReport
from metafab.mask import read
from metafab.spec import Design


def check(
    path: Path,
    design: Design,
    *,
    engine: str = "lattice",
    workers: int | None = None,
    cluster: str | None = None,
    progress: Progress = silent,
    copy: int = 1,
) -> DrcReport:
    """Check a GDSII or OASIS file.

    Args:
        path: the file; nothing but the file is looked at.
        design: rules, lattice, aperture, layer.
        engine: ``lattice`` knows where pillars should be and checks every rule exactly; ``rectangles`` knows the
            file's rectangles and no lattice; ``polygons`` is KLayout's and knows only shapes. The last two check
            width, aspect ratio, gap, overlap, grid and foreign shapes.
        workers: threads; the cores unless given.
        cluster: address of a Dask scheduler whose workers check bands of rows (``lattice``) or rows of tiles
            (``polygons``; they must see the file at the same path). ``rectangles`` is one stream and runs here.
        progress: told about rows or tiles.
        copy: the lens of ``mask.copies`` that ``lattice`` checks, counted from 1; the others are counted. The two
            engines that know no lattice check all of them.

    Raises:
        InputError: the file cannot be read as a mask, or the engine is unknown.
        MissingToolError: KLayout is not installed.
    """
    start = time.perf_counter()
    if engine == "lattice":
        report = check_lattice(read(path, design, progress, copy), design, workers, progress, cluster)
    elif engine == "rectangles":
        if cluster is not None:
            raise InputError.single(
                "--cluster", "engine", "'lattice' or 'polygons'", repr(engine), "it runs on one machine: leave it out"
            )
        report = check_rectangles(path, design, workers, progress)
    elif engine == "polygons":
        from metafab.drc.polygons import check_polygons

        report = check_polygons(path, design, workers, progress, cluster)
    else:
        raise InputError.single("--engine", "engine", "'lattice', 'rectangles' or 'polygons'", repr(engine))
    return replace(report, seconds=time.perf_counter() - start)
