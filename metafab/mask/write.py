"""A PillarMap -> the mask files of a design, in one pass over its tiles."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metafab import __version__
from metafab.core.errors import InputError
from metafab.core.parallel.executor import default_workers, in_order
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.files import fingerprint, whole_file, write_json
from metafab.layout import Lattice, PillarMap, PillarTile, field_sites, lattice_of
from metafab.layout.geometry import whole_dbu
from metafab.layout.turned import outline_of
from metafab.mask.drawing.cell_writer import Drawing, EncodedTile, MaskWriter, TileEncoder
from metafab.mask.drawing.cells import count_sizes, top_name
from metafab.mask.drawing.copies import lens_copies
from metafab.mask.drawing.stamps import Stamps
from metafab.mask.drawing.surroundings import Surroundings, surroundings
from metafab.mask.exposure import write_time
from metafab.mask.gdsii.writer import GdsiiWriter
from metafab.mask.oasis.writer import OasisWriter
from metafab.mask.viewer import layer_properties
from metafab.spec import Design

WRITERS: dict[str, type[MaskWriter]] = {"gds": GdsiiWriter, "oas": OasisWriter}
_BUFFER_BYTES = 1 << 20


@dataclass(frozen=True)
class WrittenFile:
    """A file on disk."""

    path: Path
    bytes: int


def write(
    pillars: PillarMap,
    directory: Path,
    design: Design,
    progress: Progress = silent,
    mapping: Mapping[str, Any] | None = None,
    executor: Executor | None = None,
) -> tuple[WrittenFile, ...]:
    """Write ``layout.gds`` and ``layout.oas`` (as ``mask.formats`` asks), ``layout.lyp`` and ``layout.json``.

    The same pillars and design give the same bytes. Memory stays that of a few tiles.

    Pillars are drawn with ``mask.bias_nm``, on a datatype for each of the classes of ``mask.dose``; the top cell
    holds what ``mask.chip`` and ``mask.tone`` add, and the lens as often as ``mask.copies`` lists it. A pillar has
    the same dose class in every copy, whatever their bias. Options that the design leaves out change no byte.
    What an earlier call left in a format that is not asked for now is removed: ``layout.json`` would not tell of it.

    Args:
        pillars: what shall stand; drawn sizes must be even in database units.
        directory: made if missing; files appear under their names only when whole.
        design: formats, layer, unit, write field, name.
        progress: told about pillars written.
        mapping: how well the pillars follow their targets, for ``layout.json``.
        executor: encodes tiles; threads of this process unless given. The file is written here.

    Returns:
        The files in the order of their names above.

    Raises:
        InputError: edges would lie off the grid, or a format cannot hold the layout.
    """
    files: dict[str, Path] = {suffix: directory / f"layout.{suffix}" for suffix in design.mask.formats}
    sidecar = write_drawings(pillars, files, design, progress, executor)
    _write_text(directory / "layout.lyp", layer_properties(design, surroundings(design)))
    for other in WRITERS.keys() - files.keys():
        (directory / f"layout.{other}").unlink(missing_ok=True)
    write_json(directory / "layout.json", sidecar if mapping is None else {**sidecar, "mapping": dict(mapping)})
    paths = [*files.values(), directory / "layout.lyp", directory / "layout.json"]
    return tuple(WrittenFile(path, path.stat().st_size) for path in paths)


def write_drawings(
    pillars: PillarMap,
    files: Mapping[str, Path],
    design: Design,
    progress: Progress = silent,
    executor: Executor | None = None,
) -> dict[str, Any]:
    """Write upright or turned pillars to mask files, without their sidecars.

    Args:
        pillars: drawn sizes must be even in database units.
        files: path by format, "gds" or "oas".
        design: layer, unit, write field, name.
        progress: called while tiles are written.
        executor: encodes tiles; threads of this process unless given.

    Returns:
        The contents of ``layout.json``: provenance, counts and areas.

    Raises:
        InputError: edges would lie off the grid, or a format cannot hold the layout.
    """
    _check_grid(pillars, design)
    drawn = biased(pillars, design.mask.bias_nm)
    for copy in design.mask.copies:
        biased(drawn, copy.bias_nm)  # refused now rather than after an hour
    beside = surroundings(design)
    stamps = Stamps(drawn, design)
    figures = _Figures(drawn, design)
    with ExitStack() as stack:
        writers: list[MaskWriter] = []
        for suffix, path in files.items():
            part = stack.enter_context(whole_file(path))
            stream = stack.enter_context(part.open("wb", buffering=_BUFFER_BYTES))
            writers.append(WRITERS[suffix](stream, drawing_of(drawn.lattice, design)))
        executor = executor or stack.enter_context(ThreadPoolExecutor(default_workers()))
        encode = _Encoding(stamps, tuple(writer.encoder for writer in writers))
        seen: set[tuple[int, int]] = set()
        sites = drawn.lattice.shape[0] * drawn.lattice.shape[1]
        for tile, cells in in_order(executor, encode, _filled(drawn), ahead=default_workers() + 1):
            seen.add((tile.row, tile.column))
            for number, cell in enumerate(cells):
                writers[number % len(writers)].add(cell)
            figures.add(tile)
            progress("mask", figures.sites, sites)
        drawn_beside = [*((kind.layer, kind.rectangles) for kind in beside), *stamps.beside(seen)]
        for writer in writers:
            writer.close(drawn_beside)
        progress("mask", sites, sites)
    written = {suffix: path.stat().st_size for suffix, path in files.items()}
    return {**_provenance(design, beside), **figures.summary(stamps, seen), "bytes": written}


@dataclass(frozen=True)
class _Encoding:
    """A tile in every format, one after the other, for each of its stamps."""

    stamps: Stamps
    encoders: tuple[TileEncoder, ...]

    def __call__(self, tile: PillarTile) -> tuple[PillarTile, list[EncodedTile]]:
        """The tile, and what is drawn on its sites."""
        return tile, [encoder(*part) for part in self.stamps.of(tile) for encoder in self.encoders]


def drawing_of(lattice: Lattice, design: Design) -> Drawing:
    """What the writers know of a design's mask."""
    copies = lens_copies(design) if design.mask.copies or design.mask.flat else ()
    return Drawing(lattice, top_name(design.name), copies, design.mask.flat)


class _Figures:
    """Counts and areas, added up while tiles pass."""

    def __init__(self, pillars: PillarMap, design: Design) -> None:
        self._map = pillars
        self._design = design
        across, along = self._field_sites = field_sites(design)
        rows, columns = pillars.lattice.shape
        self._shapes_in = np.zeros((-(-rows // along), -(-columns // across)), dtype=np.int64)
        self._twice_area_in_dbu = np.zeros_like(self._shapes_in)
        self._outline = outline_of(pillars, design)
        # Twice the area: whole numbers, whatever the outline.
        self._twice_area_dbu = self._twice_area(0)
        self._used = np.zeros(len(pillars.size_dbu), dtype=np.int64)
        self.sites = 0

    def add(self, tile: PillarTile) -> None:
        """Count the pillars of a tile; tiles lie within a write field."""
        across, along = self._field_sites
        field = tile.row // along, tile.column // across
        used = count_sizes(tile.size_index, self._used.size)
        self._shapes_in[field] += used[1:].sum()
        self._twice_area_in_dbu[field] += used @ self._twice_area_dbu
        self._used += used
        self.sites += tile.size_index.size

    def summary(self, stamps: Stamps, seen: set[tuple[int, int]]) -> dict[str, Any]:
        """Pillars, sizes, drawn area, its share of the pillars' cells, all of one lens; copies and write time if asked.

        Where ``mask.copies`` lists several lenses, the write time is that of all of them.

        Args:
            stamps: what was drawn.
            seen: (row, column) of the tiles that hold pillars.
        """
        pillars = int(self._used[1:].sum())
        lattice = self._map.lattice
        unit_um = lattice.database_unit_nm * 1e-3
        # Whole numbers of squared units: exact, whatever the order of the sum.
        area = self._area_dbu(0)
        cell_um2 = lattice.cell_um2
        field_um2 = math.prod(self._field_sites) * math.prod(lattice.period_dbu) * unit_um**2
        figures: dict[str, Any] = {
            "pillars": pillars,
            "distinct_sizes": int(np.count_nonzero(self._used[1:])),
            "area_um2": area * unit_um**2,
            "density": area * unit_um**2 / (pillars * cell_um2) if pillars else 0.0,
            # Drawn area over that of the whole write field, by rows from the lowest y and columns from the lowest x.
            "field_density": np.round(self._twice_area_in_dbu / 2 * unit_um**2 / field_um2, 6).tolist(),
        }
        mask, copies = self._design.mask, lens_copies(self._design)
        areas_um2 = [self._area_dbu(copy.bias_dbu) * unit_um**2 for copy in copies]
        if mask.copies:
            figures["copies"] = [
                {"at_um": copy.at_um, "bias_nm": copy.bias_nm, "label": copy.label, "area_um2": area_um2}
                for copy, area_um2 in zip(mask.copies, areas_um2, strict=True)
            ]
        if mask.exposure is not None:
            exposed_um2, fields = sum(areas_um2), int(np.count_nonzero(self._shapes_in))
            if mask.tone != "negative":
                sites_um2 = math.prod(lattice.shape) * math.prod(lattice.period_dbu) * unit_um**2
                # The field reaches to the corners of the square, where no pillar stands.
                exposed_um2, fields = len(copies) * sites_um2 - exposed_um2, self._shapes_in.size
            shapes = stamps.exposed(self._used, seen)
            figures["exposure"] = write_time(mask.exposure, exposed_um2, shapes, len(copies) * fields)
        return figures

    def _area_dbu(self, bias_dbu: int) -> float:
        """Drawn area of one lens with a bias, squared units."""
        return int(self._used @ self._twice_area(bias_dbu)) / 2

    def _twice_area(self, bias_dbu: int) -> NDArray[np.int64]:
        """Twice the area of each size with a bias; index 0 means no pillar and has none."""
        size_dbu = self._map.size_dbu + np.int32(bias_dbu)
        size_dbu[0] = 0
        return np.asarray(np.rint(2.0 * self._outline.area(size_dbu)), dtype=np.int64)


def biased(pillars: PillarMap, bias_nm: float) -> PillarMap:
    """The same pillars, ``bias_nm`` wider and longer (or narrower and shorter): as they are drawn, or as they stand.

    Raises:
        InputError: the bias is no even number of database units, or a size would vanish.
    """
    if bias_nm == 0.0:
        return pillars
    unit_nm = pillars.lattice.database_unit_nm
    bias_dbu = whole_dbu(bias_nm, unit_nm, "mask.bias_nm", even=True)
    size_dbu = pillars.size_dbu.copy()
    size_dbu[1:] += bias_dbu
    if np.any(size_dbu[1:] <= 0):
        smallest = float(pillars.size_nm()[1:].min())
        raise InputError.single("mask", "bias_nm", f"less than the smallest side, {smallest:g} nm", f"{bias_nm:g} nm")
    return replace(pillars, size_dbu=size_dbu)


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


_TONES = {
    "negative": "what is drawn is exposed and stays (negative resist): pillars",
    "inverted": "what is drawn on the field layer is exposed and goes (positive resist): all but the pillars",
    "positive": "what is exposed goes (positive resist): expose the write field NOT the pillars",
}


def _provenance(design: Design, beside: Sequence[Surroundings]) -> dict[str, Any]:
    lattice = lattice_of(design)
    options: dict[str, Any] = {}
    if design.mask.bias_nm:
        options["bias_nm"] = design.mask.bias_nm
    if design.mask.flat:
        options["flat"] = True
    if design.mask.dose is not None:
        options["dose"] = design.mask.dose
    if beside:
        options["beside"] = {f"{kind.layer}/0": kind.name for kind in beside}
    return {
        "kind": "metafab mask",
        "format_version": 1,
        "metafab_version": __version__,
        "design": design.name,
        "design_sha256": fingerprint(design),
        "top_cell": top_name(design.name),
        "layer": design.mask.layer,
        "datatype": design.mask.datatype,
        "tone": _TONES[design.mask.tone],
        "database_unit_nm": design.mask.database_unit_nm,
        "lattice": "hexagonal" if lattice.hexagonal else "rectangular",
        "period_nm": design.unit_cell.cell.period_nm,
        "sites": {"rows": lattice.shape[0], "columns": lattice.shape[1]},
        "write_field_um": design.mask.write_field_um,
        "write_field_sites": field_sites(design),
        **options,
    }


def _write_text(path: Path, text: str) -> None:
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8")
