"""Design rules on a written mask by all three engines: lattice, rectangles, polygons. ``error`` counts violations."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.mask.lens import closed_form_library, lens_design, lens_profile
from metafab import drc, layout, mask
from metafab.core.parallel.measure import measured


def rows(quick: bool) -> list[dict[str, Any]]:
    """One row per file and engine; the small lens if ``quick``, else 25.6 million pillars."""
    design = lens_design(quick)
    profile, library = lens_profile(design), closed_form_library(design.unit_cell)
    small = replace(design, device=replace(design.device, aperture_um=20.0))
    table = []
    with TemporaryDirectory() as name:
        folder = Path(name)
        for warm in mask.write(layout.assign(profile, library, small).pillars, folder, small)[:2]:
            for engine in ("lattice", "rectangles"):
                drc.check(warm.path, small, engine=engine)
        files = mask.write(layout.assign(profile, library, design).pillars, folder, design)
        cases = [(file.path, engine) for engine in ("lattice", "rectangles") for file in files[:2]]
        cases.append((folder / "layout.oas", "polygons"))
        for path, engine in cases:
            with measured() as cost:
                report = drc.check(path, design, engine=engine)
            table.append(
                {
                    "name": f"{engine}, {path.suffix[1:]}, reading included",
                    "error": float(sum(report.violations.values())),
                    **vars(cost),
                    "pillars": report.pillars,
                }
            )
    return table
