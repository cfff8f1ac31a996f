"""A mask file -> the pillars in it, and everything in it that is none."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Literal

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.parallel.executor import default_workers, in_order
from metafab.core.parallel.progress import Progress, silent
from metafab.layout import Lattice, Outline, PillarMap, lattice_of, tile_sites
from metafab.mask.drawing.copies import OtherCopies, lens_copies, lens_copy
from metafab.mask.gdsii.reader import GdsiiReader
from metafab.mask.oasis.reader import MixedBlockError, OasisReader
from metafab.mask.oasis.writer import MAGIC
from metafab.mask.shapes.hierarchy import Chunk, Hierarchy, IntArray, Other, Part
from metafab.mask.shapes.known import RECTANGLES, KnownShapes
from metafab.mask.shapes.recover import DUPLICATE, KEPT, OFF_GRID, OFF_SITE, Recovery
from metafab.spec import Design

Format = Literal["gds", "oas"]

_GDSII_BEGINNING = b"\x00\x06\x00\x02"

# Parts up to this many shapes are held whole while they wait for their turn.
_AHEAD_SHAPES = 1 << 19


@dataclass(frozen=True)
class Leftover:
    """Shapes on the pillar layer that are no pillar of the lattice.

    Attributes:
        count: how many.
        boxes_nm: the first of them, shape (m, 4), x, y of the lower left corner, width, height of the bounding box.
    """

    count: int
    boxes_nm: FloatArray


@dataclass(frozen=True)
class ReadBack:
    """What a mask file holds; nothing in it is left out.

    Places of what is no pillar are those in the file, whatever copy of the lens was read.

    Attributes:
        path: the file.
        format: which of the two formats.
        pillars: rectangles (or what else the design's pillars are drawn as) centred on sites of its lattice, no larger
            than its cells.
        at_nm: where the centre of that lattice stands in the file, (x, y).
        other_copies: rectangles in the squares of the other copies of ``mask.copies``, by number from 1.
        off_site: rectangles elsewhere, or larger.
        off_grid: rectangles whose edges are no whole number of the design's database units.
        duplicates: rectangles at sites that hold one already (the first in the file is in ``pillars``).
        foreign: polygons, paths and so on, by kind.
        other_layers: shapes and texts on other layers, counted by "layer/datatype".
        top_cells: names of the cells that no other places.
        database_unit_nm: unit of the file.
    """

    path: Path
    format: Format
    pillars: PillarMap
    at_nm: tuple[float, float]
    other_copies: dict[int, int]
    off_site: Leftover
    off_grid: Leftover
    duplicates: Leftover
    foreign: dict[str, Leftover]
    other_layers: dict[str, int]
    top_cells: tuple[str, ...]
    database_unit_nm: float


def read(
    path: Path, design: Design, progress: Progress = silent, copy: int = 1, known: KnownShapes | None = None
) -> ReadBack:
    """Read the pillars of ``design`` from a GDSII or OASIS file, told apart by its first bytes.

    The file may be metafab's own or have been through other software: flat or hierarchical, with arrays and
    repetitions, mirrored or turned by right angles, renamed, in other units.

    Args:
        path: the file.
        design: whose lattice, layer and unit the pillars are read for.
        progress: told about bytes indexed and shapes read.
        copy: which lens of ``mask.copies``, counted from 1; rectangles of the others are counted, not placed.
        known: recognises pillars among shapes; by default those of the design's cross-section, upright.

    Raises:
        InputError: the file is missing, empty, truncated, damaged or of another kind, or holds far more shapes
            than the design has sites; or the design has no such copy.
    """
    kind = format_of(path)
    layer = (design.mask.layer, *design.mask.datatypes)
    known = known or KnownShapes(Outline.of(design))
    if kind == "gds":
        return _recover(path, kind, GdsiiReader(path, layer, progress, known=known), design, progress, copy)
    try:
        reader = OasisReader(path, layer, progress, known=known)
        return _recover(path, kind, reader, design, progress, copy)
    except MixedBlockError:
        reader = OasisReader(path, layer, progress, known=known, skip_blocks=False)
        return _recover(path, kind, reader, design, progress, copy)


@dataclass(frozen=True)
class Shapes:
    """What is drawn on the pillar layer of a file, whatever lattice it came from.

    Attributes:
        unit_nm: database unit of the file.
        count: how many.
        other_layers: shapes and texts on other layers, counted by "layer/datatype".
        top_cells: names of the cells that no other places.
        chunks: opens the stream of shapes, in file units; each time from the start.
    """

    unit_nm: float
    count: int
    other_layers: dict[str, int]
    top_cells: tuple[str, ...]
    chunks: Callable[[], Iterator[Chunk]]


def read_shapes(path: Path, design: Design, progress: Progress = silent, *, known: KnownShapes = RECTANGLES) -> Shapes:
    """Open a GDSII or OASIS file as rectangles (or what else is ``known``) and others, without a lattice.

    Raises:
        InputError: as :func:`read`.
    """
    layer = (design.mask.layer, *design.mask.datatypes)
    # Blocks are not skipped: a stream cannot be begun again once it is found to hold more than pillars.
    reader = (
        GdsiiReader(path, layer, progress, known=known)
        if format_of(path) == "gds"
        else OasisReader(path, layer, progress, known=known, skip_blocks=False)
    )
    hierarchy = Hierarchy(reader.cells, str(path))
    count = hierarchy.count()
    if count > 2**31:
        raise _too_many(path, lattice_of(design), count)
    return Shapes(reader.unit_nm, count, hierarchy.other_layers(), hierarchy.tops, lambda: _chunks(hierarchy))


def _recover(
    path: Path, kind: Format, reader: GdsiiReader | OasisReader, design: Design, progress: Progress, copy: int
) -> ReadBack:
    """Put the shapes of all cells at their sites."""
    lattice, place, ratio = lattice_of(design), lens_copy(design, copy), _ratio(reader.unit_nm, design)
    others = OtherCopies(design, copy, ratio)
    hierarchy = Hierarchy(reader.cells, str(path))
    total = hierarchy.count()
    limit = 16 * len(lens_copies(design)) * lattice.shape[0] * lattice.shape[1] + 1_000_000
    if total > limit:
        raise _too_many(path, lattice, total)
    recovery = Recovery(lattice, ratio, str(path), (place.x_dbu, place.y_dbu))
    foreign: Counter[str] = Counter()
    boxes: dict[str, list[Other]] = {}
    done = 0
    crosses = design.unit_cell.cell.shape == "cross"
    for chunk in _chunks(hierarchy):
        pillars = _wide(chunk.rectangles) if crosses else chunk.rectangles
        recovery.add(others.without(pillars, chunk.shift), chunk.shift)
        for other in chunk.others:
            foreign[other.kind] += other.count
            if other.box is not None and len(boxes.setdefault(other.kind, [])) < KEPT:
                boxes[other.kind].append(other)
        done += len(chunk.rectangles)
        if done > limit:  # the count before was an estimate where blocks were skipped
            raise _too_many(path, lattice, done)
        progress("reading", min(done, total), total)
    progress("reading", total, total)
    size_dbu = recovery.finish()
    unit_nm = reader.unit_nm

    def leftover(stray: int) -> Leftover:
        """What was kept apart, in nm."""
        found = recovery.strays(stray)
        return Leftover(found.count, np.multiply(found.rectangles, unit_nm, dtype=np.float64))

    return ReadBack(
        path=path,
        format=kind,
        pillars=PillarMap.from_array(lattice, size_dbu, recovery.size_index, tile_sites(design)),
        at_nm=(place.x_dbu * design.mask.database_unit_nm, place.y_dbu * design.mask.database_unit_nm),
        other_copies=others.counts,
        off_site=leftover(OFF_SITE),
        off_grid=leftover(OFF_GRID),
        duplicates=leftover(DUPLICATE),
        foreign={
            name: Leftover(
                count, np.array([o.box for o in boxes.get(name, ())], dtype=np.float64).reshape(-1, 4) * unit_nm
            )
            for name, count in sorted(foreign.items())
        },
        other_layers=hierarchy.other_layers(),
        top_cells=hierarchy.tops,
        database_unit_nm=unit_nm,
    )


def _wide(rectangles: IntArray) -> IntArray:
    """The same crosses, none longer than wide: a cell turned by 90 degrees exchanges what means the same cross."""
    longer = (rectangles[:, 3] - rectangles[:, 2]) // 2
    if not np.any(longer > 0):
        return rectangles
    more = np.maximum(longer, 0)[:, None] * np.array([[-1, 1, 2, -2]])
    return np.asarray(rectangles + more)


def _too_many(path: Path, lattice: Lattice, count: int) -> InputError:
    sites = lattice.shape[0] * lattice.shape[1]
    return InputError.single(
        str(path), "shapes", f"about as many as the design's {sites} sites", str(count), "is it another design's?"
    )


def _chunks(hierarchy: Hierarchy) -> Iterator[Chunk]:
    """All chunks in the order of the file; parts of a tile's size are decoded ahead by threads."""

    def decode(part: Part) -> Iterator[Chunk]:
        """Small parts here and now, on the thread that asks; large ones as a stream."""
        return iter(list(part.chunks())) if part.count <= _AHEAD_SHAPES else part.chunks()

    with ThreadPoolExecutor(default_workers()) as threads:
        for chunks in in_order(threads, decode, hierarchy.parts(), ahead=default_workers() + 1):
            yield from chunks


def format_of(path: Path) -> Format:
    """Which format a file has, by its first bytes.

    Raises:
        InputError: it is missing, unreadable, or neither GDSII nor OASIS.
    """
    expected, remedy = "a GDSII or OASIS file", "write it with `metafab layout DESIGN.toml`"
    if not path.is_file():
        raise InputError.single(str(path), "file", expected, "nothing at that path", remedy)
    try:
        with path.open("rb") as stream:
            beginning = stream.read(len(MAGIC))
    except OSError as error:
        raise InputError.single(str(path), "file", expected, f"an unreadable file ({error})", remedy) from error
    if beginning == MAGIC:
        return "oas"
    if beginning.startswith(_GDSII_BEGINNING):
        return "gds"
    got = "a file of another kind" if beginning else "an empty file"
    raise InputError.single(str(path), "file", expected, got, remedy)


def _ratio(unit_nm: float, design: Design) -> Fraction:
    """File units in the design's units, a fraction of small whole numbers."""
    return Fraction(unit_nm / design.mask.database_unit_nm).limit_denominator(1_000_000)
