"""The files next to a mask: provenance and figures (``layout.json``), layer names for KLayout (``layout.lyp``)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metafab import __version__
from metafab.core.conventions import FloatArray
from metafab.core.figures import WriteTime
from metafab.core.storage.files import fingerprint, plain
from metafab.layout import Outline, PillarMap, PillarTile, field_sites, lattice_of
from metafab.layout.turned import outline_of
from metafab.mask.drawing.cells import top_name
from metafab.mask.drawing.copies import LensCopy, lens_copies
from metafab.mask.drawing.include import IncludedCell
from metafab.mask.drawing.scan import count_sizes
from metafab.mask.drawing.stamps import Stamps
from metafab.mask.drawing.surroundings import surroundings
from metafab.mask.writing import FieldTimes, LensLoad, beam_seconds, field_times, fracture, write_time
from metafab.spec import Design, Exposure

_TONES = {
    "negative": "what is drawn is exposed and stays (negative resist): pillars",
    "inverted": "what is drawn on the field layer is exposed and goes (positive resist): all but the pillars",
    "positive": "what is exposed goes (positive resist): expose the write field NOT the pillars",
}


@dataclass(frozen=True)
class CopyFigures:
    """One lens of ``mask.copies``."""

    at_um: tuple[float, float]  #: (x, y) of its optical axis.
    bias_nm: float  #: Its own bias.
    dose: float  #: Relative to the base dose.
    focus_um: float  #: Focus of the exposure.
    datatypes: tuple[int, int]  #: First and last datatype of its pillars.
    label: str | None  #: Text above it.
    area_um2: float  #: Drawn area of its pillars.


@dataclass(frozen=True)
class IncludeFigures:
    """One cell of ``mask.include``."""

    file: str  #: Name of its file.
    cell: str  #: Name of the cell.
    polygons: dict[str, int]  #: Number of polygons on each "layer/datatype".
    texts: int  #: Number of texts.


@dataclass(frozen=True, eq=False)
class MaskFigures:
    """Counts and areas of a written mask; those of one lens, if there are several."""

    pillars: int  #: Number of pillars.
    distinct_sizes: int  #: Number of different sizes.
    area_um2: float  #: Drawn area of the pillars.
    density: float  #: Drawn area over the area of the pillars' cells.
    #: Shape (rows, columns), drawn area over the area of each whole write field, by rows from the lowest y and columns
    #: from the lowest x.
    field_density: FloatArray
    copies: tuple[CopyFigures, ...] = ()  #: The lenses of ``mask.copies``.
    exposure: WriteTime | None = None  #: Write time of all lenses; None without ``mask.exposure``.
    include: tuple[IncludeFigures, ...] = ()  #: The cells of ``mask.include``.
    #: Write fields in the order of writing; None without ``mask.exposure``, or where the field is exposed.
    fields: FieldTimes | None = None


@dataclass(frozen=True, eq=False)
class TileCount:
    """Number of pillars of a tile."""

    row: int  #: Row of its first site.
    column: int  #: Column of its first site.
    sites: int  #: Number of its sites.
    used: NDArray[np.int64]  #: Shape (n_sizes + 1,), number of sites of each size index.

    @classmethod
    def of(cls, tile: PillarTile, sizes: int) -> TileCount:
        """Count a tile whose size indices are below ``sizes``."""
        used = count_sizes(np.ascontiguousarray(tile.size_index), sizes)
        return cls(tile.row, tile.column, tile.size_index.size, used)


class MaskSums:
    """Counts and areas of the pillars, added up tile by tile.

    Args:
        pillars: the drawn pillars.
        design: write field, copies, exposure.

    Attributes:
        sites: number of sites of the tiles added so far.
        filled: (row, column) of these tiles.
    """

    def __init__(self, pillars: PillarMap, design: Design) -> None:
        self._map = pillars
        self._design = design
        across, along = self._field_sites = field_sites(design)
        rows, columns = pillars.lattice.shape
        self._pillars_in = np.zeros((-(-rows // along), -(-columns // across)), dtype=np.int64)
        self._twice_area_in_dbu = np.zeros_like(self._pillars_in)
        self._outline = outline_of(pillars, design)
        self._twice_area_dbu = self._twice_area(0)
        self._fracture = _fractured(pillars, design, self._outline)
        self._load_in = np.zeros((2, *self._pillars_in.shape), dtype=np.int64)
        self._used = np.zeros(len(pillars.size_dbu), dtype=np.int64)
        self.sites = 0
        self.filled: set[tuple[int, int]] = set()

    def add(self, tile: TileCount) -> None:
        """Add the pillars of a tile, which lies within a write field."""
        across, along = self._field_sites
        field = tile.row // along, tile.column // across
        used = tile.used
        self._pillars_in[field] += used[1:].sum()
        self._twice_area_in_dbu[field] += used @ self._twice_area_dbu
        if self._fracture is not None:
            self._load_in[:, field[0], field[1]] += self._fracture @ used
        self._used += used
        self.sites += tile.sites
        self.filled.add((tile.row, tile.column))

    def figures(self, stamps: Stamps, included: Sequence[IncludedCell]) -> MaskFigures:
        """Return the figures of the mask with the shapes ``stamps`` and the cells ``included`` of other files."""
        mask, lattice, copies = self._design.mask, self._map.lattice, lens_copies(self._design)
        pillars = int(self._used[1:].sum())
        dbu2_um2 = (lattice.database_unit_nm * 1e-3) ** 2
        area_um2 = self._area_dbu(0) * dbu2_um2
        field_um2 = math.prod(self._field_sites) * math.prod(lattice.period_dbu) * dbu2_um2
        areas_um2 = [self._area_dbu(copy.variant.bias_dbu) * dbu2_um2 for copy in copies]
        each_copy = []
        for copy, place, copy_um2 in zip(mask.copies, copies, areas_um2, strict=False):
            first = mask.datatype + place.variant.dose_number * mask.dose_classes
            datatypes = (first, first + mask.dose_classes - 1)
            figures = CopyFigures(copy.at_um, copy.bias_nm, copy.dose, copy.focus_um, datatypes, copy.label, copy_um2)
            each_copy.append(figures)
        exposure, fields = self._write_time(stamps, areas_um2) if mask.exposure is not None else (None, None)
        return MaskFigures(
            pillars=pillars,
            distinct_sizes=int(np.count_nonzero(self._used[1:])),
            area_um2=area_um2,
            density=area_um2 / (pillars * lattice.cell_um2) if pillars else 0.0,
            field_density=np.round(self._twice_area_in_dbu / 2 * dbu2_um2 / field_um2, 6),
            copies=tuple(each_copy),
            exposure=exposure,
            include=tuple(IncludeFigures(cell.file, cell.cell, cell.counts, len(cell.texts)) for cell in included),
            fields=fields,
        )

    def _write_time(self, stamps: Stamps, areas_um2: Sequence[float]) -> tuple[WriteTime, FieldTimes | None]:
        """Write time of all lenses with the areas ``areas_um2`` of their pillars, and their fields in order."""
        mask, copies = self._design.mask, lens_copies(self._design)
        doses = [mask.doses[copy.variant.dose_number] for copy in copies]
        shapes = stamps.exposed(self._used, self.filled)
        assert mask.exposure is not None
        if mask.tone == "negative" and self._fracture is not None:
            return self._time_of_pillars(mask.exposure, shapes, list(zip(copies, doses, areas_um2, strict=True)))
        loads = self._loads_of_field(mask.exposure, shapes, list(zip(doses, areas_um2, strict=True)))
        return write_time(mask.exposure, loads, shapes, len(copies) * self._pillars_in.size), None

    def _loads_of_field(self, exposure: Exposure, shapes: int, lenses: Sequence[tuple[float, float]]) -> list[LensLoad]:
        """Loads where all but the pillars is exposed, of lenses by dose and area of their pillars (um^2)."""
        lattice = self._map.lattice
        sites_um2 = math.prod(lattice.shape) * math.prod(lattice.period_dbu) * (lattice.database_unit_nm * 1e-3) ** 2
        # The field reaches to the corners of the square, where no pillar stands.
        each = np.full(len(lenses), shapes // len(lenses))
        each[: shapes % len(lenses)] += 1
        loads = []
        for (dose, area_um2), count in zip(lenses, each.tolist(), strict=True):
            exposed_um2 = sites_um2 - area_um2
            shots = None if exposure.shot_pitch_nm is None else math.ceil(exposed_um2 * 1e6 / exposure.shot_pitch_nm**2)
            loads.append(LensLoad(dose, exposed_um2, count, shots))
        return loads

    def _time_of_pillars(
        self, exposure: Exposure, shapes: int, lenses: Sequence[tuple[LensCopy, float, float]]
    ) -> tuple[WriteTime, FieldTimes]:
        """Write time where pillars are exposed, of lenses with their dose and the area of their pillars (um^2)."""
        trapezoids, shots = (int(total) for total in self._load_in.sum(axis=(1, 2)))
        plain_um2, counted = self._area_dbu(0) * (self._map.lattice.database_unit_nm * 1e-3) ** 2, shots > 0
        loads, times = [], []
        field_share = self._twice_area_in_dbu / max(1, int(self._twice_area_in_dbu.sum()))
        for _, dose, area_um2 in lenses:
            # A bias changes the shots of a Gaussian beam in proportion to the area.
            grown = area_um2 / plain_um2 if plain_um2 else 0.0
            scale = grown if exposure.shot_pitch_nm is not None else 1.0
            loads.append(LensLoad(dose, area_um2, trapezoids, round(shots * scale) if counted else None))
            settling_s = self._load_in[0] * exposure.settle_shape_us * 1e-6
            settling_s = settling_s + (self._pillars_in > 0) * exposure.settle_field_ms * 1e-3
            beam_s = beam_seconds(exposure, dose, field_share * area_um2, self._load_in[1] * scale)
            times.append(np.asarray(beam_s + settling_s, dtype=np.float64))
        fields = field_times(exposure, times, [self._field_centres_um(copy) for copy, _, _ in lenses])
        stitching = fields.stitching_nm if exposure.drift_nm_per_min else None
        filled = len(lenses) * int(np.count_nonzero(self._pillars_in))
        return write_time(exposure, loads, shapes, filled, stitching), fields

    def _field_centres_um(self, copy: LensCopy) -> FloatArray:
        """Centre (x, y) of each write field of a lens, shape (rows, columns, 2); fields at the rim are cut off."""
        lattice, um = self._map.lattice, self._map.lattice.database_unit_nm * 1e-3
        centres = []
        for site, count, sites in (
            (lattice.x_dbu(), self._pillars_in.shape[1], self._field_sites[0]),
            (lattice.y_dbu(), self._pillars_in.shape[0], self._field_sites[1]),
        ):
            first = np.arange(count) * sites
            last = np.minimum(first + sites, site.size) - 1
            centres.append(0.5 * (site[first] + site[last]))
        x, y = np.meshgrid(centres[0] + copy.x_dbu, centres[1] + copy.y_dbu)
        return np.stack([x, y], axis=-1) * um

    def _area_dbu(self, bias_dbu: int) -> float:
        """Drawn area of one lens with a bias, squared database units."""
        return int(self._used @ self._twice_area(bias_dbu)) / 2

    def _twice_area(self, bias_dbu: int) -> NDArray[np.int64]:
        """Twice the area of each size with a bias: whole numbers, so that sums are exact in any order."""
        size_dbu = self._map.size_dbu + np.int32(bias_dbu)
        size_dbu[0] = 0
        return np.asarray(np.rint(2.0 * self._outline.area(size_dbu)), dtype=np.int64)


@dataclass(frozen=True)
class WrittenMask:
    """A mask that was written, with what its sidecar states."""

    design: Design  #: The design that it was made from.
    figures: MaskFigures  #: Counts and areas.
    files: Mapping[str, Path]  #: The mask files by format, "gds" and "oas".

    def to_json(self) -> dict[str, Any]:
        """Contents of ``layout.json``: provenance, options, figures, and the bytes of each file."""
        return _sidecar(self.design, self.figures, self.files)


def _sidecar(design: Design, figures: MaskFigures, files: Mapping[str, Path]) -> dict[str, Any]:
    lattice, mask = lattice_of(design), design.mask
    options: dict[str, Any] = {}
    if mask.bias_nm:
        options["bias_nm"] = mask.bias_nm
    if mask.flat:
        options["flat"] = True
    if mask.dose is not None:
        options["dose"] = mask.dose
    around = surroundings(design)
    if around:
        options["beside"] = {f"{layer.layer}/0": layer.name for layer in around}
    if mask.kit is not None:
        pillars = [f"{mask.layer}/{datatype}" for datatype in range(mask.datatypes[0], mask.datatypes[1] + 1)]
        first, second = ([f"{one.layer}/0" for one in around if one.exposure == number] for number in (1, 2))
        options["exposures"] = [first, pillars + second] if first else [pillars + second]
    counts = {name: value for name, value in plain(replace(figures, fields=None)).items() if value not in (None, [])}
    table: dict[str, Any] = plain(
        {
            "kind": "metafab mask",
            "format_version": 1,
            "metafab_version": __version__,
            "design": design.name,
            "design_sha256": fingerprint(design),
            "top_cell": top_name(design.name),
            "layer": mask.layer,
            "datatype": mask.datatype,
            "tone": _TONES[mask.tone],
            "database_unit_nm": mask.database_unit_nm,
            "lattice": "hexagonal" if lattice.hexagonal else "rectangular",
            "period_nm": design.unit_cell.cell.period_nm,
            "sites": {"rows": lattice.shape[0], "columns": lattice.shape[1]},
            "write_field_um": mask.write_field_um,
            "write_field_sites": field_sites(design),
            **options,
            **counts,
            "bytes": {suffix: path.stat().st_size for suffix, path in files.items()},
        }
    )
    return table


_LAYER_PROPERTIES = """ <properties>
  <frame-color>{frame}</frame-color>
  <fill-color>{fill}</fill-color>
  <frame-brightness>0</frame-brightness>
  <fill-brightness>0</fill-brightness>
  <dither-pattern>I1</dither-pattern>
  <visible>true</visible>
  <transparent>false</transparent>
  <width>1</width>
  <marked>false</marked>
  <animation>0</animation>
  <name>{name}</name>
  <source>{source}@1</source>
 </properties>
"""

# Colours of frame and fill.
_PILLARS = ("#1f4e79", "#5b9bd5")
_SURROUNDINGS = ("#6b4f1d", "#c9a75a")


def layer_properties(design: Design) -> str:
    """Return the text of ``layout.lyp``: pillar layer with a datatype for each dose class, field and surroundings."""
    first, last = design.mask.datatypes
    layers = []
    for datatype in range(first, last + 1):
        name = f"pillars of {design.name}" + (f", dose class {datatype - first}" if last > first else "")
        layers.append((name, f"{design.mask.layer}/{datatype}", _PILLARS))
    if design.mask.tone == "inverted":
        layers.append(("field around the pillars", f"{design.mask.field_layer}/0", _SURROUNDINGS))
    layers += [(layer.name, f"{layer.layer}/0", _SURROUNDINGS) for layer in surroundings(design)]
    entries = "".join(
        _LAYER_PROPERTIES.format(name=escape(name), source=source, frame=frame, fill=fill)
        for name, source, (frame, fill) in layers
    )
    return f'<?xml version="1.0" encoding="utf-8"?>\n<layer-properties>\n{entries}</layer-properties>\n'


def _fractured(pillars: PillarMap, design: Design, outline: Outline) -> NDArray[np.int64] | None:
    """Trapezoids and shots of each size, shape (2, n_sizes + 1); None where no pillar is exposed."""
    if design.mask.exposure is None or design.mask.tone != "negative":
        return None
    size_dbu = pillars.size_dbu.astype(np.int64)
    return fracture(outline.polygons(size_dbu), design.mask.database_unit_nm, design.mask.exposure)
