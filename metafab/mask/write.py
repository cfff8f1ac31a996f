"""A PillarMap -> the mask files of a design, in one pass over its tiles."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from metafab import __version__
from metafab.core.errors import InputError
from metafab.core.executor import default_workers, in_order
from metafab.core.files import fingerprint, whole_file, write_json
from metafab.core.progress import Progress, silent
from metafab.layout import PillarMap, PillarTile, field_sites, lattice_of
from metafab.mask.cells import top_name
from metafab.mask.gdsii_writer import GdsiiWriter
from metafab.mask.oasis_writer import OasisWriter
from metafab.mask.viewer import layer_properties
from metafab.spec import Design

WRITERS: dict[str, type[GdsiiWriter] | type[OasisWriter]] = {"gds": GdsiiWriter, "oas": OasisWriter}
_BUFFER_BYTES = 1 << 20


@dataclass(frozen=True)
class WrittenFile:
    """A file on disk."""

    path: Path
    bytes: int


def write(pillars: PillarMap, directory: Path, design: Design, progress: Progress = silent) -> tuple[WrittenFile, ...]:
    """Write ``layout.gds`` and ``layout.oas`` (as ``mask.formats`` asks), ``layout.lyp`` and ``layout.json``.

    The same pillars and design give the same bytes. Memory stays that of a few tiles.

    Args:
        pillars: what to write; sizes must be even in database units.
        directory: made if missing; files appear under their names only when whole.
        design: formats, layer, unit, write field, name.
        progress: told about pillars written.

    Returns:
        The files in the order of their names above.

    Raises:
        InputError: edges would lie off the grid, or a format cannot hold the layout.
    """
    _check_grid(pillars, design)
    figures = _Figures(pillars)
    files = {suffix: directory / f"layout.{suffix}" for suffix in design.mask.formats}
    with ExitStack() as stack:
        writers: list[GdsiiWriter | OasisWriter] = []
        for suffix, path in files.items():
            part = stack.enter_context(whole_file(path))
            stream = stack.enter_context(part.open("wb", buffering=_BUFFER_BYTES))
            arguments = (top_name(design.name), design.mask.layer, design.mask.datatype)
            writers.append(WRITERS[suffix](stream, pillars.lattice, pillars.size_dbu, *arguments))
        threads = stack.enter_context(ThreadPoolExecutor(default_workers()))

        def encode(tile: PillarTile) -> tuple[PillarTile, list[Any]]:
            """One tile in every format."""
            return tile, [writer.encode(tile) for writer in writers]

        sites = pillars.lattice.shape[0] * pillars.lattice.shape[1]
        for tile, encoded in in_order(threads, encode, _filled(pillars), ahead=default_workers() + 1):
            for writer, cell in zip(writers, encoded, strict=True):
                writer.add(cell)
            figures.add(tile)
            progress("mask", figures.sites, sites)
        for writer in writers:
            writer.close()
        progress("mask", sites, sites)
    _write_text(directory / "layout.lyp", layer_properties(design))
    written = {suffix: path.stat().st_size for suffix, path in files.items()}
    write_json(directory / "layout.json", {**_provenance(design), **figures.summary(), "bytes": written})
    paths = [*files.values(), directory / "layout.lyp", directory / "layout.json"]
    return tuple(WrittenFile(path, path.stat().st_size) for path in paths)


class _Figures:
    """Counts and areas, added up while tiles pass."""

    def __init__(self, pillars: PillarMap) -> None:
        self._map = pillars
        self._used = np.zeros(len(pillars.size_dbu), dtype=np.int64)
        self.sites = 0

    def add(self, tile: PillarTile) -> None:
        """Count the pillars of a tile."""
        self._used += np.bincount(tile.size_index.ravel(), minlength=self._used.size)
        self.sites += tile.size_index.size

    def summary(self) -> dict[str, Any]:
        """Pillars, sizes, drawn area, and its share of the pillars' cells."""
        pillars = int(self._used[1:].sum())
        lattice = self._map.lattice
        unit_um = lattice.database_unit_nm * 1e-3
        # Whole numbers of squared units: exact, whatever the order of the sum.
        area = int(self._used @ np.prod(self._map.size_dbu.astype(np.int64), axis=1))
        cell_um2 = lattice.period_dbu[0] * lattice.period_dbu[1] * unit_um**2
        return {
            "pillars": pillars,
            "distinct_sizes": int(np.count_nonzero(self._used[1:])),
            "area_um2": area * unit_um**2,
            "density": area * unit_um**2 / (pillars * cell_um2) if pillars else 0.0,
        }


def _filled(pillars: PillarMap) -> Iterator[PillarTile]:
    return (tile for tile in pillars.tiles() if tile.size_index.any())


def _check_grid(pillars: PillarMap, design: Design) -> None:
    if pillars.lattice.database_unit_nm != design.mask.database_unit_nm:
        raise InputError.single(
            design.name,
            "mask.database_unit_nm",
            f"the unit of the pillars, {pillars.lattice.database_unit_nm:g} nm",
            f"{design.mask.database_unit_nm:g} nm",
            "map the design again",
        )
    odd = np.flatnonzero(np.any(pillars.size_dbu % 2, axis=1))
    if odd.size:
        width, length = pillars.size_nm()[odd[0]]
        raise InputError.single(
            design.name,
            "mask.database_unit_nm",
            "sizes of an even number of units, so that centred rectangles have their edges on the grid",
            f"{odd.size} others (such as {width:g} nm x {length:g} nm in units of {design.mask.database_unit_nm:g} nm)",
            "halve the unit or use a coarser `sweep.size_grid_nm`; nothing is rounded silently",
        )


def _provenance(design: Design) -> dict[str, Any]:
    lattice = lattice_of(design)
    return {
        "kind": "metafab mask",
        "format_version": 1,
        "metafab_version": __version__,
        "design": design.name,
        "design_sha256": fingerprint(design),
        "top_cell": top_name(design.name),
        "layer": design.mask.layer,
        "datatype": design.mask.datatype,
        "tone": "what is drawn is exposed and stays (negative resist): pillars",
        "database_unit_nm": design.mask.database_unit_nm,
        "period_nm": design.unit_cell.cell.period_nm,
        "sites": {"rows": lattice.shape[0], "columns": lattice.shape[1]},
        "write_field_um": design.mask.write_field_um,
        "write_field_sites": field_sites(design),
    }


def _write_text(path: Path, text: str) -> None:
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8")
