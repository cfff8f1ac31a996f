"""A PillarMap -> the mask files of a design, in one pass over its tiles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from metafab.core.arguments import require_types
from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.parallel.executor import default_workers
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.files import whole_file, write_json
from metafab.layout import Lattice, PillarMap, PillarTile
from metafab.layout.assign import Assignment
from metafab.layout.geometry import whole_dbu
from metafab.mask.drawing.cell_writer import Drawing, EncodedTile, MaskWriter, TileEncoder
from metafab.mask.drawing.cells import top_name
from metafab.mask.drawing.copies import LensCopy
from metafab.mask.drawing.dose import DOSE_DATATYPES, DOSE_TABLES, datatype_doses, dose_tables
from metafab.mask.drawing.include import shapes_beside
from metafab.mask.drawing.stamps import Stamps
from metafab.mask.gdsii.writer import GdsiiWriter, write_dose_datatypes
from metafab.mask.oasis.writer import OasisWriter
from metafab.mask.sidecar import MaskFigures, MaskSums, TileCount, WrittenMask, layer_properties
from metafab.spec import Design

WRITERS: dict[str, type[MaskWriter]] = {"gds": GdsiiWriter, "oas": OasisWriter}
_BUFFER_BYTES = 1 << 20


@dataclass(frozen=True)
class WrittenFile:
    """A file on disk."""

    path: Path  #: The file.
    bytes: int  #: Its size.


def write(
    pillars: PillarMap,
    directory: Path | str,
    design: Design,
    progress: Progress = silent,
    mapping: Assignment | None = None,
    executor: Executor | None = None,
    dose_class: Sequence[NDArray[np.uint8]] = (),
    class_dose: FloatArray | None = None,
    *,
    dose_datatypes: bool = False,
) -> tuple[WrittenFile, ...]:
    """Write masks ``layout.gds`` and ``.oas`` (of ``mask.formats``), ``layout.lyp`` and ``layout.json``; return all.

    A design with several doses also gets the dose of each datatype as ``doses.csv``, ``.jdi`` and ``.txt``, one with
    ``mask.exposure`` the order of its write fields as ``fields.csv``.

    Equal pillars and designs give equal bytes. Only a few tiles are held in memory. Files appear under their names only
    when complete.

    Pillars are drawn with ``mask.bias_nm``, on one datatype for each class of ``mask.dose``. The top cell also holds
    the shapes of ``mask.chip`` and ``mask.tone``, and one lens for each of ``mask.copies``. Options that the design
    leaves out change no byte. A file of an earlier call that this one does not write is removed, because
    ``layout.json`` would not describe it.

    Further arguments and errors are those of :func:`write_drawings`.

    Args:
        mapping: choice of the pillars, whose figures go into ``layout.json``.
        class_dose: shape (classes,), dose of each class relative to the base dose; None if it is not known.
        dose_datatypes: whether ``doses.gds``, the mask with doses in thousandths as datatypes, is written; needs "gds"
            in ``mask.formats``.
    """
    require_types("mask", pillars=(pillars, PillarMap), design=(design, Design))
    directory = Path(directory)
    files: dict[str, Path] = {suffix: directory / f"layout.{suffix}" for suffix in design.mask.formats}
    figures = write_drawings(pillars, files, design, progress, executor, dose_class)
    tables = {"fields.csv": figures.fields.table()} if figures.fields is not None else {}
    tables |= dose_tables(design, class_dose)
    texts = {"layout.lyp": layer_properties(design)}
    texts |= {name: "\n".join([*lines, ""]) for name, lines in tables.items()}
    for name, text in texts.items():
        with whole_file(directory / name) as part:
            part.write_text(text, encoding="utf-8")
    table = WrittenMask(design, figures, files).to_json()
    write_json(directory / "layout.json", table if mapping is None else {**table, "mapping": mapping.to_json()})
    written = [*(path.name for path in files.values()), "layout.lyp", "layout.json", *sorted(tables)]
    if dose_datatypes:
        doses = datatype_doses(design, class_dose)
        write_dose_datatypes(files["gds"], directory / DOSE_DATATYPES, design.mask.layer, doses)
        written.append(DOSE_DATATYPES)
    earlier = {*(f"layout.{suffix}" for suffix in WRITERS), "fields.csv", DOSE_DATATYPES, *DOSE_TABLES}
    for name in earlier.difference(written):
        (directory / name).unlink(missing_ok=True)
    return tuple(WrittenFile(path, path.stat().st_size) for path in map(directory.joinpath, written))


def table_names(design: Design) -> tuple[str, ...]:
    """Names of the tables that :func:`write` makes for a design without doses of classes."""
    mask = design.mask
    has_fields = mask.exposure is not None and mask.tone == "negative"
    return *(("fields.csv",) if has_fields else ()), *dose_tables(design)


def write_drawings(
    pillars: PillarMap,
    files: Mapping[str, Path],
    design: Design,
    progress: Progress = silent,
    executor: Executor | None = None,
    dose_class: Sequence[NDArray[np.uint8]] = (),
) -> MaskFigures:
    """Write upright or turned pillars to mask ``files`` by format ("gds", "oas"), without their sidecars.

    Drawn sizes must be even in database units. ``executor`` encodes tiles, by default threads of this process;
    ``dose_class``, shape (n_y, n_x) of the lattice each, is the class of each site for ``mask.dose.by = "proximity"``:
    one array for all lenses, or one for each; lenses with the same array share their cells. InputError if dose classes
    are missing or do not fit, edges would lie off the grid, or a format cannot hold the layout.
    """
    _require_grid(pillars, design)
    drawn = biased(pillars, design.mask.bias_nm)
    for copy in design.mask.copies:
        biased(drawn, copy.bias_nm)  # Refuses a bad bias now rather than after an hour.
    around, included = shapes_beside(design)
    in_top_cell = [(layer.layer, layer.rectangles) for layer in around]
    polygons = [(one.layer, one.datatype, one.corners) for cell in included for one in cell.polygons]
    texts = [(one.layer, one.kind, one.at_dbu, one.words) for cell in included for one in cell.texts]
    stamps = Stamps(drawn, design, dose_class)
    sums = MaskSums(drawn, design)
    with ExitStack() as stack:
        writers: list[MaskWriter] = []
        for suffix, path in files.items():
            part = stack.enter_context(whole_file(path))
            stream = stack.enter_context(part.open("wb", buffering=_BUFFER_BYTES))
            writers.append(WRITERS[suffix](stream, drawing_of(drawn.lattice, design, stamps.copies)))
        executor = executor or stack.enter_context(ThreadPoolExecutor(default_workers()))
        encode = _Encoding(stamps, tuple(writer.encoder for writer in writers), len(drawn.size_dbu))
        sites = drawn.lattice.shape[0] * drawn.lattice.shape[1]
        for count, encoded in drawn.apply(encode, executor, default_workers() + 1):
            for number, cell in enumerate(encoded):
                writers[number % len(writers)].add(cell)
            if encoded:
                sums.add(count)
            progress("mask", sums.sites, sites)
        in_top_cell += stamps.without_pillars(sums.filled)
        for writer in writers:
            writer.close(in_top_cell, polygons, texts)
        progress("mask", sites, sites)
    return sums.figures(stamps, included)


@dataclass(frozen=True)
class _Encoding:
    """Encodes all stamps of a tile, each in every format."""

    stamps: Stamps
    encoders: tuple[TileEncoder, ...]
    sizes: int

    def __call__(self, tile: PillarTile) -> tuple[TileCount, list[EncodedTile]]:
        """Count the tile, and return its encoded cells, formats alternating."""
        parts = list(self.stamps.of(tile)) if tile.size_index.any() else []
        encoded = [cell for cells in zip(*(encoder(parts) for encoder in self.encoders), strict=True) for cell in cells]
        return TileCount.of(tile, self.sizes), encoded


def drawing_of(lattice: Lattice, design: Design, copies: tuple[LensCopy, ...]) -> Drawing:
    """Return the properties of a design's mask that the writers need; ``copies`` are all its lenses."""
    several = copies if design.mask.copies or design.mask.flat else ()
    return Drawing(lattice, top_name(design.name), several, design.mask.flat)


def biased(pillars: PillarMap, bias_nm: float) -> PillarMap:
    """Return the pillars with ``bias_nm`` added to width and length.

    InputError if the bias is not an even number of database units, or a size would vanish.
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


def _require_grid(pillars: PillarMap, design: Design) -> None:
    """Refuse another database unit, and sizes whose edges would lie off the grid."""
    unit_nm = design.mask.database_unit_nm
    if pillars.lattice.database_unit_nm != unit_nm:
        expected = f"the unit of the pillars, {pillars.lattice.database_unit_nm:g} nm"
        got = f"{unit_nm:g} nm"
        raise InputError.single(design.name, "mask.database_unit_nm", expected, got, "map the design again")
    odd = np.flatnonzero(np.any(pillars.size_dbu % 2, axis=1))
    if odd.size:
        width, length = pillars.size_nm()[odd[0]]
        expected = "sizes of an even number of units, so that centred rectangles have their edges on the grid"
        got = f"{odd.size} others (such as {width:g} nm x {length:g} nm in units of {unit_nm:g} nm)"
        remedy = "halve the unit or use a coarser `sweep.size_grid_nm`; nothing is rounded silently"
        raise InputError.single(design.name, "mask.database_unit_nm", expected, got, remedy)
