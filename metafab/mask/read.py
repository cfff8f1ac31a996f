"""A mask file -> its pillars, and every shape that is not a pillar."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Literal

import numpy as np

from metafab.core.display import Displayed
from metafab.core.errors import InputError
from metafab.core.parallel.executor import default_workers, in_order
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.files import Latest, file_mark, require_file
from metafab.core.storage.limits import beyond, limit, limited
from metafab.layout import Outline, PillarMap, lattice_of, tile_sites
from metafab.mask.budget import UNKNOWN_SITES, Budget
from metafab.mask.drawing.copies import OtherCopies, lens_copies, lens_copy
from metafab.mask.gdsii.reader import GdsiiReader
from metafab.mask.oasis.reader import MixedBlockError, OasisReader
from metafab.mask.oasis.writer import MAGIC
from metafab.mask.shapes.hierarchy import Chunk, Hierarchy, IntArray, Other, Part
from metafab.mask.shapes.recover import DUPLICATE, KEPT, OFF_GRID, OFF_SITE, RECTANGLES, KnownShapes, Leftover, Recovery
from metafab.spec import Design
from metafab.spec.mask import MOST_DATATYPES

Format = Literal["gds", "oas"]

_GDSII_BEGINNING = b"\x00\x06\x00\x02"

#: Estimated processor time of a chunk of shapes, s, whatever is in it.
_SECONDS_OF_A_CHUNK = 5e-5

# Parts of up to this many shapes are decoded ahead and held in memory.
_AHEAD_SHAPES = 1 << 19


@dataclass(frozen=True, eq=False, repr=False)
class ReadBack(Displayed):
    """The contents of a mask file; nothing is left out.

    Places of leftovers are those in the file, whichever copy of the lens was read.
    """

    path: Path  #: The file.
    format: Format  #: Its format.
    #: Rectangles (or other shapes of the design's pillars) centred on sites of its lattice, no larger than its cells.
    pillars: PillarMap
    at_nm: tuple[float, float]  #: (x, y) of the centre of that lattice in the file.
    #: Number of rectangles in the squares of the other copies of ``mask.copies``, by number from 1.
    other_copies: dict[int, int]
    off_site: Leftover  #: Rectangles elsewhere, or larger than a cell.
    off_grid: Leftover  #: Rectangles whose edges are not a whole number of the design's database units.
    duplicates: Leftover  #: Rectangles at sites that hold one already (the first in the file is in ``pillars``).
    foreign: dict[str, Leftover]  #: Polygons, paths and so on, by kind.
    other_layers: dict[str, int]  #: Number of shapes and texts on other layers, by "layer/datatype".
    top_cells: tuple[str, ...]  #: Names of the cells that no other cell places.
    database_unit_nm: float  #: Unit of the file.
    copies: dict[int, PillarMap]  #: Pillars of the other copies that were asked for, by number from 1.
    #: First and last datatype of the pillars: the design's, or those of the dose classes of a corrected mask.
    datatypes: tuple[int, int]

    def key_figures(self) -> dict[str, str]:
        """File, pillars, and the number of leftovers of each kind."""
        count = sum(int(np.count_nonzero(tile.size_index)) for tile in self.pillars.tiles())
        kinds = ", ".join(f"{left.count} {kind}" for kind, left in self.foreign.items() if left.count)
        layers = ", ".join(f"{shapes} on {layer}" for layer, shapes in self.other_layers.items())
        return {
            "file": self.path.name,
            "pillars": f"{count}",
            "off site": f"{self.off_site.count}",
            "off grid": f"{self.off_grid.count}",
            "duplicates": f"{self.duplicates.count}",
            "foreign": kinds or "none",
            "other layers": layers or "none",
        }

    @property
    def stands_at_um(self) -> tuple[float, float] | None:
        """Centre of the lens in the file, (x, y), if no pillar lies at a site of the design.

        None if some do, if there are too many to keep the places of all, or if they extend over another area than the
        lattice.
        """
        boxes, lattice = self.off_site.boxes_nm, self.pillars.lattice
        if not len(boxes) or len(boxes) < self.off_site.count or self._has_pillars:
            return None
        centres_nm = boxes[:, :2] + 0.5 * boxes[:, 2:]
        low, high = centres_nm.min(axis=0), centres_nm.max(axis=0)
        sites_um = lattice.x_um()[[0, -1]], lattice.y_um()[[0, -1]]
        if not np.allclose(high - low, [1e3 * np.ptp(axis) for axis in sites_um], rtol=0.0, atol=1e-3):
            return None
        x_um, y_um = np.round(0.5e-3 * (low + high), 6).tolist()
        return x_um, y_um

    @property
    def _has_pillars(self) -> bool:
        return any(tile.size_index.any() for tile in self.pillars.tiles())

    def require_pillars_alone(self, remedy: str) -> None:
        """Refuse a lens without pillars, or a pillar layer with anything else than pillars at sites of the lattice.

        ``remedy`` is the consequence for the caller, and what to do. InputError with the number of leftovers of each
        kind.
        """
        unplaced = {
            "off the lattice": self.off_site.count,
            "off the grid": self.off_grid.count,
            "at a site that has one already": self.duplicates.count,
            **{f"of the kind {kind}": left.count for kind, left in self.foreign.items()},
        }
        got = ", ".join(f"{count} {where}" for where, count in unplaced.items() if count)
        if got:
            expected = "rectangles at lattice sites and nothing else on the pillar layer"
            if (at_um := self.stands_at_um) is not None:
                remedy = place_remedy(at_um)
            raise InputError.single(str(self.path), "pillars", expected, got, remedy)
        if not self._has_pillars:
            expected, remedy = "at least one at a site of the lens", "read the mask with its own design"
            if self.other_layers:
                got = f"none on its layer, and {', '.join(f'{n} on {layer}' for layer, n in self.other_layers.items())}"
                remedy += "; are `mask.layer` and `mask.datatype` those of the file?"
            raise InputError.single(str(self.path), "pillars", expected, got or "none", remedy)


def place_remedy(at_um: tuple[float, float]) -> str:
    """Return a sentence on a lens that stands elsewhere than in the design: about ``at_um``, (x, y)."""
    x, y = (f"{value:.10g}" for value in at_um)
    return (
        f"the pillars stand as far apart as in the design, about ({x}, {y}) um: name this place by `at_um` in "
        "`[[mask.copies]]`"
    )


def read(
    path: Path | str,
    design: Design,
    progress: Progress = silent,
    copy: int = 1,
    known: KnownShapes | None = None,
    along: Collection[int] = (),
) -> ReadBack:
    """Read the pillars of ``design`` from a GDSII or OASIS file, recognised by its first bytes.

    The file may be metafab's own or have been through other software: flat or hierarchical, with arrays and
    repetitions, mirrored or turned by right angles, renamed, in other units.

    ``copy`` is a lens of ``mask.copies``, counted from 1. Rectangles of the other lenses are counted; those of the
    numbers ``along`` are read as pillars, too. A design with ``[process.exposure]`` reads the classes of its corrected
    mask, however many the file has. ``known`` recognises pillars among shapes; by default those of the design's
    cross-section, upright. ``progress`` gets the number of indexed bytes and of read shapes.

    InputError if the file is missing, empty, truncated, damaged or of another kind, or holds far more shapes than the
    design has sites; or the design has no such copy; or rectangles of a copy in ``along`` are not at its sites.
    """
    path, known = Path(path), known or KnownShapes(Outline.of(design))
    with limited(**design.stated_limits):
        try:
            return _recover(path, _open(path, design, progress, known, skip_blocks=True), design, progress, copy, along)
        except MixedBlockError:
            reader = _open(path, design, progress, known, skip_blocks=False)
            return _recover(path, reader, design, progress, copy, along)


#: The file that was read last.
_LATEST: Latest[ReadBack] = Latest()


def read_shared(path: Path, design: Design, progress: Progress = silent, copy: int = 1) -> ReadBack:
    """Return :func:`read` of a file; what was read last is kept, and shared by all callers, who must not change it.

    The rules, the light and the page of a run need the same file.
    """
    if not path.is_file():
        return read(path, design, progress, copy)  # which refuses it
    return _LATEST.of((path, file_mark(path), design, copy), lambda: read(path, design, progress, copy))


@dataclass(frozen=True)
class Shapes:
    """The shapes on the pillar layer of a file, of any lattice."""

    unit_nm: float  #: Database unit of the file.
    count: int  #: Number of shapes.
    other_layers: dict[str, int]  #: Number of shapes and texts on other layers, by "layer/datatype".
    top_cells: tuple[str, ...]  #: Names of the cells that no other cell places.
    datatypes: tuple[int, int]  #: First and last datatype of the pillars, as of :class:`ReadBack`.
    chunks: Callable[[], Iterator[Chunk]]  #: Opens the stream of shapes, in file units; each time from the start.


def read_shapes(path: Path, design: Design, progress: Progress = silent, *, known: KnownShapes = RECTANGLES) -> Shapes:
    """Open a GDSII or OASIS file as rectangles (or the shapes ``known``) and others, without a lattice.

    Errors as :func:`read`.
    """
    # Blocks are not skipped: a stream cannot start again once a block is found to hold more than pillars.
    with limited(**design.stated_limits):
        reader = _open(path, design, progress, known, skip_blocks=False)
        hierarchy = Hierarchy(reader.cells, str(path))
        count = hierarchy.count()
        _refuse_many(path, count, _most_shapes(design))
        reader.budget.place(count)
    others, datatypes = hierarchy.other_layers(), reader.layer[1:]
    return Shapes(reader.unit_nm, count, others, hierarchy.tops, datatypes, lambda: _chunks(hierarchy, reader))


def _open(
    path: Path, design: Design, progress: Progress, known: KnownShapes, *, skip_blocks: bool
) -> GdsiiReader | OasisReader:
    """Index a file. A corrected mask has more datatypes than its design: it is then indexed once more with these."""
    is_gdsii = format_of(path) == "gds"

    def opened(datatypes: tuple[int, int]) -> GdsiiReader | OasisReader:
        layer, budget = (design.mask.layer, *datatypes), Budget(path, _sites(design), tiles=_tiles(design))
        if is_gdsii:
            return GdsiiReader(path, layer, progress, known=known, budget=budget)
        return OasisReader(path, layer, progress, known=known, skip_blocks=skip_blocks, budget=budget)

    reader = opened(design.mask.datatypes)
    datatypes = _datatypes(design, Hierarchy(reader.cells, str(path)).other_layers())
    return reader if datatypes == design.mask.datatypes else opened(datatypes)


def _datatypes(design: Design, other_layers: Iterable[str]) -> tuple[int, int]:
    """First and last datatype of the pillars in a file, which holds ``other_layers`` beside those of the design.

    The correction of doses draws each class on a datatype of its own; nothing else is drawn on the pillar layer.
    """
    first, last = design.mask.datatypes
    process = None if design.process is None else design.process.exposure
    if process is None or process.correction != "dose":
        return first, last
    names = (name.partition("/") for name in other_layers)
    found = [int(kind) for layer, _, kind in names if layer == str(design.mask.layer) and kind.isdigit()]
    return first, max((kind for kind in found if first <= kind < first + MOST_DATATYPES), default=last)


def _recover(
    path: Path,
    reader: GdsiiReader | OasisReader,
    design: Design,
    progress: Progress,
    copy: int,
    along: Collection[int],
) -> ReadBack:
    """Put the shapes of all cells at their sites."""
    lattice, place, unit_nm = lattice_of(design), lens_copy(design, copy), reader.unit_nm
    ratio = _unit_ratio(path, unit_nm, design)
    others = OtherCopies(design, copy, ratio)
    hierarchy = Hierarchy(reader.cells, str(path))
    if hierarchy.is_distorted and not reader.is_counted:
        raise MixedBlockError
    total, most, done = hierarchy.count(), _most_shapes(design), 0
    _refuse_many(path, total, most)
    if reader.is_counted:
        reader.budget.place(total)
    recovery, *further = (
        Recovery(lattice, ratio, str(path), (place.x_dbu, place.y_dbu))
        for place in (place, *(lens_copy(design, number) for number in along))
    )
    recoveries, foreign = dict(zip(along, further, strict=True)), _ForeignShapes()
    crosses = design.unit_cell.cell.shape == "cross"
    for chunk in _chunks(hierarchy, reader):
        pillars = _wide_crosses(chunk.rectangles) if crosses else chunk.rectangles
        own, of_copies = others.apart(pillars, chunk.shift)
        recovery.add(own, chunk.shift)
        for number in recoveries.keys() & of_copies.keys():
            recoveries[number].add(of_copies[number], chunk.shift)
        for other in chunk.others:
            foreign.add(other)
        shapes = len(chunk.rectangles) + sum(len(other.boxes) for other in chunk.others)
        done += shapes
        if not reader.is_counted:  # The total was an estimate: blocks were skipped.
            _refuse_many(path, done, most)
            reader.budget.place(shapes)
        progress("reading", min(done, total), total)
    progress("reading", total, total)

    def placed(found: Recovery) -> PillarMap:
        return PillarMap.from_array(lattice, found.finish(), found.size_index, tile_sites(design))

    _require_on_sites(path, recoveries)
    return ReadBack(
        path=path,
        format=format_of(path),
        pillars=placed(recovery),
        at_nm=(place.x_dbu * design.mask.database_unit_nm, place.y_dbu * design.mask.database_unit_nm),
        other_copies=others.counts,
        off_site=recovery.leftover(OFF_SITE, unit_nm),
        off_grid=recovery.leftover(OFF_GRID, unit_nm),
        duplicates=recovery.leftover(DUPLICATE, unit_nm),
        foreign=foreign.leftovers(unit_nm),
        other_layers=hierarchy.other_layers(),
        top_cells=hierarchy.tops,
        database_unit_nm=unit_nm,
        copies={number: placed(found) for number, found in recoveries.items()},
        datatypes=reader.layer[1:],
    )


def _unit_ratio(path: Path, unit_nm: float, design: Design) -> Fraction:
    """Unit of a file in units of the design; InputError where it is less than a millionth of them."""
    ratio = Fraction(unit_nm / design.mask.database_unit_nm).limit_denominator(1_000_000)
    if not ratio:
        expected = f"a database unit of about {design.mask.database_unit_nm:g} nm, as in the design"
        remedy = "export the file with that unit"
        raise InputError.single(str(path), "database unit", expected, f"{unit_nm:g} nm", remedy)
    return ratio


def _require_on_sites(path: Path, recoveries: Mapping[int, Recovery]) -> None:
    """Refuse copies of the lens, by number, with rectangles that are not at their sites."""
    for number, found in recoveries.items():
        if stray := sum(found.count(kind) for kind in (OFF_SITE, OFF_GRID, DUPLICATE)):
            expected, got = "rectangles at its lattice sites alone", f"{stray} others"
            raise InputError.single(str(path), f"copy {number}", expected, got, "`metafab drc` lists their places")


@dataclass
class _ForeignShapes:
    """Foreign shapes of a file by kind: counts of all, boxes of the first of each kind."""

    counts: Counter[str] = field(default_factory=Counter)
    boxes: dict[str, list[IntArray]] = field(default_factory=dict)

    def add(self, other: Other) -> None:
        """Count a shape, and keep its boxes while there is room."""
        self.counts[other.kind] += other.count
        kept = self.boxes.setdefault(other.kind, [])
        kept.extend(other.boxes[: max(0, KEPT - len(kept))])

    def leftovers(self, unit_nm: float) -> dict[str, Leftover]:
        """The shapes of each kind, in the order of their names."""
        return {
            kind: Leftover(count, np.array(self.boxes[kind], dtype=np.float64).reshape(-1, 4) * unit_nm)
            for kind, count in sorted(self.counts.items())
        }


def _wide_crosses(rectangles: IntArray) -> IntArray:
    """Exchange width and length of crosses that are longer than wide: a turn by 90 degrees leaves a cross unchanged."""
    longer = (rectangles[:, 3] - rectangles[:, 2]) // 2
    if not np.any(longer > 0):
        return rectangles
    more = np.maximum(longer, 0)[:, None] * np.array([[-1, 1, 2, -2]])
    return np.asarray(rectangles + more)


def _most_shapes(design: Design) -> float:
    """Number of shapes above which a file is another design's."""
    return limit("shapes", 16 * _sites(design) + 1_000_000)


def _sites(design: Design) -> int:
    """Number of sites of all lenses, which sets the budget of a file."""
    try:
        return math.prod(lattice_of(design).shape) * len(lens_copies(design))
    except InputError:  # Rules are checked even where the period is no whole number of units.
        return UNKNOWN_SITES


def _tiles(design: Design) -> int:
    """Number of tiles of all lenses, each a cell of the file; 0 where the design's write fields cut pillars."""
    try:
        side, shape = tile_sites(design), lattice_of(design).shape
        return math.prod(-(-count // side) for count in shape) * len(lens_copies(design))
    except InputError:
        return 0


def _refuse_many(path: Path, count: int, most: float) -> None:
    """Refuse (InputError) a file with more than ``most`` shapes."""
    if count > most:
        raise beyond(str(path), "shapes", "shapes", f"at most {most:g}", str(count), "is it another design's?")


def _chunks(hierarchy: Hierarchy, reader: GdsiiReader | OasisReader) -> Iterator[Chunk]:
    """All chunks in the order of the file; parts of a tile's size are decoded ahead by threads."""

    def decode(part: Part) -> Iterator[Chunk]:
        """Decode small parts now, on the calling thread, and open large ones as a stream."""
        return iter(list(part.chunks())) if part.count <= _AHEAD_SHAPES else part.chunks()

    with ThreadPoolExecutor(default_workers()) as threads:
        for chunks in in_order(threads, decode, hierarchy.parts(), ahead=default_workers() + 1):
            for chunk in chunks:
                reader.budget.work(_SECONDS_OF_A_CHUNK)
                yield chunk


def format_of(path: Path) -> Format:
    """Return the format of a file, by its first bytes; InputError if it is missing, or neither GDSII nor OASIS."""
    expected, remedy = "a GDSII or OASIS file", "write it with `metafab layout DESIGN.toml`"
    require_file(path, expected, remedy)
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
