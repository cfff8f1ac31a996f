"""From phases to mask files and back: seconds and peak memory, compared with a raw write, gdstk and KLayout.

``error`` is the phase rms in radians for the mapping; for files it is the number of pillars that differ, or of polygons
of an exclusive or. The last rows compare both gap rules (``efficiency``, ``mean_transmittance``).
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import gdstk
import numpy as np

from benchmarks.mask.lens import closed_form_library, gap_rows, lens_design, lens_profile
from metafab import layout, mask
from metafab.core.parallel.measure import Cost, measured
from metafab.layout import PillarMap
from metafab.spec import Design


def rows(quick: bool) -> list[dict[str, Any]]:
    """One row per step or peer; the small lens if ``quick``, else 25.6 million pillars."""
    design = lens_design(quick)
    profile, library = lens_profile(design), closed_form_library(design.unit_cell)
    _warm_up(design, profile, library)
    table: list[dict[str, Any]] = []
    with measured() as cost:
        assignment = layout.assign(profile, library, design)
    pillars = assignment.figures.pillars
    table.append(_row("mapping, phases included", assignment.figures.phase_rms_error_rad, cost, pillars))
    with TemporaryDirectory() as folder:
        for suffix in ("oas", "gds"):
            # One folder per format: writing one format removes a file of the other.
            table += _own(suffix, assignment.pillars, design, Path(folder, suffix), pillars)
            table += _peers(suffix, Path(folder, suffix), pillars, quick)
        table += _exclusive_or(Path(folder), pillars)
    return table + gap_rows(quick)


def _own(suffix: str, pillars: PillarMap, design: Design, folder: Path, count: int) -> list[dict[str, Any]]:
    """Rows of metafab: write a format, write as many raw bytes, read back."""
    only = replace(design, mask=replace(design.mask, formats=(suffix,)))
    with measured() as cost:
        written = mask.write(pillars, folder, only)[0]
    table = [{**_row(f"write {suffix}", 0.0, cost, count), "bytes": written.bytes}]
    block = os.urandom(1 << 20)
    with measured() as cost, (folder / "raw").open("wb") as stream:
        for _ in range(-(-written.bytes // len(block))):
            stream.write(block)
    (folder / "raw").unlink()
    table.append({**_row(f"raw write of the bytes of {suffix}", 0.0, cost, count), "bytes": written.bytes})
    with measured() as cost:
        read_back = mask.read(written.path, design)
    expected = pillars.size_dbu[pillars.to_array()]
    found = read_back.pillars.size_dbu[read_back.pillars.to_array()]
    return [*table, _row(f"read {suffix}", float(np.count_nonzero(np.any(expected != found, axis=-1))), cost, count)]


def _peers(suffix: str, folder: Path, count: int, quick: bool) -> list[dict[str, Any]]:
    """Rows of other readers on the written file; in full size only those that take less than half a minute."""
    path = str(folder / f"layout.{suffix}")
    readers: dict[str, Callable[[], int]] = {}
    if quick or suffix == "oas":
        read = gdstk.read_oas if suffix == "oas" else gdstk.read_gds
        readers["gdstk"] = lambda: _gdstk_count(read(path))
    try:
        import klayout.db as kdb
    except ImportError:
        pass
    else:

        def by_klayout() -> int:
            opened = kdb.Layout()
            opened.read(path)
            return int(kdb.Region(opened.top_cell().begin_shapes_rec(opened.layer(1, 0))).count())

        readers["KLayout"] = by_klayout
    table = []
    for name, read_count in readers.items():
        with measured() as cost:
            found = read_count()
        table.append(_row(f"{name} reads {suffix}", float(abs(found - count)), cost, count))
    return table


def _exclusive_or(folder: Path, count: int) -> list[dict[str, Any]]:
    """Row of KLayout's exclusive or of both formats, on every sixteenth tile."""
    try:
        import klayout.db as kdb
    except ImportError:
        return []
    with measured() as cost:
        opened = [kdb.Layout(False) for _ in range(2)]
        for layout_, suffix in zip(opened, ("oas", "gds"), strict=True):
            layout_.read(str(folder / suffix / f"layout.{suffix}"))
        names = sorted(cell.name for cell in opened[0].each_cell() if cell.name.startswith("TILE"))[::16]
        tiles = [[kdb.Region(one.cell(name).shapes(one.layer(1, 0))) for one in opened] for name in names]
        differ = sum((oas ^ gds).count() for oas, gds in tiles)
        compared = sum(oas.count() for oas, _ in tiles)
    return [_row(f"KLayout: oas XOR gds, {len(names)} tiles of {compared} pillars", float(differ), cost, count)]


def _gdstk_count(library: gdstk.Library) -> int:
    """Number of pillars; makes no polygon object for each."""
    polygons = (polygon for cell in library.cells for polygon in cell.polygons)
    return sum(max(1, polygon.repetition.size) for polygon in polygons)


def _warm_up(design: Design, profile: Any, library: Any) -> None:
    """Load the compiled kernels, so that their one-time cost is not charged to the first row."""
    small = replace(design, device=replace(design.device, aperture_um=20.0))
    with TemporaryDirectory() as folder:
        files = mask.write(layout.assign(profile, library, small).pillars, Path(folder), small)
        for file in files[: len(design.mask.formats)]:
            mask.read(file.path, small)


def _row(name: str, error: float, cost: Cost, pillars: int) -> dict[str, Any]:
    return {"name": name, "error": error, **vars(cost), "pillars": pillars}
