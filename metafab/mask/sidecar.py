"""The files next to a mask: provenance and figures (``layout.json``), layer names for KLayout (``layout.lyp``)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metafab import __version__
from metafab.core.conventions import FloatArray
from metafab.core.storage.files import fingerprint, plain
from metafab.layout import PillarMap, PillarTile, field_sites, lattice_of
from metafab.layout.turned import outline_of
from metafab.mask.drawing.cells import top_name
from metafab.mask.drawing.copies import lens_copies
from metafab.mask.drawing.include import IncludedCell
from metafab.mask.drawing.scan import count_sizes
from metafab.mask.drawing.stamps import Stamps
from metafab.mask.drawing.surroundings import surroundings
from metafab.spec import Design, Exposure

_TONES = {
    "negative": "what is drawn is exposed and stays (negative resist): pillars",
    "inverted": "what is drawn on the field layer is exposed and goes (positive resist): all but the pillars",
    "positive": "what is exposed goes (positive resist): expose the write field NOT the pillars",
}


@dataclass(frozen=True)
class WriteTime:
    """Time that the e-beam takes, without blanking, alignment, further stage moves and loading.

    Attributes:
        area_um2: exposed area.
        shapes: exposed shapes.
        fields: write fields that hold any.
        beam_seconds: dose x area / current.
        settling_seconds: settling of shapes and fields.
        seconds: sum of both.
    """

    area_um2: float
    shapes: int
    fields: int
    beam_seconds: float
    settling_seconds: float
    seconds: float

    @classmethod
    def of(cls, exposure: Exposure, area_um2: float, shapes: int, fields: int) -> WriteTime:
        """Estimate the time from dose, current and settling times; all dose classes count with the nominal dose."""
        micro_coulomb = exposure.dose_uc_per_cm2 * area_um2 * 1e-8
        beam_s = micro_coulomb / (exposure.beam_current_na * 1e-3)
        settling_s = shapes * exposure.settle_shape_us * 1e-6 + fields * exposure.settle_field_ms * 1e-3
        return cls(area_um2, shapes, fields, beam_s, settling_s, beam_s + settling_s)


@dataclass(frozen=True)
class CopyFigures:
    """One lens of ``mask.copies``.

    Attributes:
        at_um: (x, y) of its optical axis.
        bias_nm: its own bias.
        label: text above it.
        area_um2: drawn area of its pillars.
    """

    at_um: tuple[float, float]
    bias_nm: float
    label: str | None
    area_um2: float


@dataclass(frozen=True)
class IncludeFigures:
    """One cell of ``mask.include``.

    Attributes:
        file: name of its file.
        cell: name of the cell.
        polygons: number of polygons on each "layer/datatype".
        texts_left_out: number of texts, which are not written.
    """

    file: str
    cell: str
    polygons: dict[str, int]
    texts_left_out: int


@dataclass(frozen=True, eq=False)
class MaskFigures:
    """Counts and areas of a written mask; those of one lens, if there are several.

    Attributes:
        pillars: number of pillars.
        distinct_sizes: number of different sizes.
        area_um2: drawn area of the pillars.
        density: drawn area over the area of the pillars' cells.
        field_density: shape (rows, columns), drawn area over the area of each whole write field, by rows from the
            lowest y and columns from the lowest x.
        copies: the lenses of ``mask.copies``.
        exposure: write time of all lenses; None without ``mask.exposure``.
        include: the cells of ``mask.include``.
    """

    pillars: int
    distinct_sizes: int
    area_um2: float
    density: float
    field_density: FloatArray
    copies: tuple[CopyFigures, ...] = ()
    exposure: WriteTime | None = None
    include: tuple[IncludeFigures, ...] = ()


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
        self._used = np.zeros(len(pillars.size_dbu), dtype=np.int64)
        self.sites = 0
        self.filled: set[tuple[int, int]] = set()

    def add(self, tile: PillarTile) -> None:
        """Count the pillars of a tile; tiles lie within a write field."""
        across, along = self._field_sites
        field = tile.row // along, tile.column // across
        used = count_sizes(tile.size_index, self._used.size)
        self._pillars_in[field] += used[1:].sum()
        self._twice_area_in_dbu[field] += used @ self._twice_area_dbu
        self._used += used
        self.sites += tile.size_index.size
        self.filled.add((tile.row, tile.column))

    def figures(self, stamps: Stamps, included: Sequence[IncludedCell]) -> MaskFigures:
        """Return the figures of the mask with the shapes ``stamps`` and the cells ``included`` of other files."""
        mask, lattice, copies = self._design.mask, self._map.lattice, lens_copies(self._design)
        pillars = int(self._used[1:].sum())
        dbu2_um2 = (lattice.database_unit_nm * 1e-3) ** 2
        area_um2 = self._area_dbu(0) * dbu2_um2
        field_um2 = math.prod(self._field_sites) * math.prod(lattice.period_dbu) * dbu2_um2
        areas_um2 = [self._area_dbu(copy.bias_dbu) * dbu2_um2 for copy in copies]
        each_copy = [
            CopyFigures(copy.at_um, copy.bias_nm, copy.label, copy_um2)
            for copy, copy_um2 in zip(mask.copies, areas_um2, strict=False)
        ]
        exposure = None
        if mask.exposure is not None:
            exposed_um2, fields = sum(areas_um2), int(np.count_nonzero(self._pillars_in))
            if mask.tone != "negative":
                sites_um2 = math.prod(lattice.shape) * math.prod(lattice.period_dbu) * dbu2_um2
                # The field reaches to the corners of the square, where no pillar stands.
                exposed_um2, fields = len(copies) * sites_um2 - exposed_um2, self._pillars_in.size
            shapes = stamps.exposed(self._used, self.filled)
            exposure = WriteTime.of(mask.exposure, exposed_um2, shapes, len(copies) * fields)
        return MaskFigures(
            pillars=pillars,
            distinct_sizes=int(np.count_nonzero(self._used[1:])),
            area_um2=area_um2,
            density=area_um2 / (pillars * lattice.cell_um2) if pillars else 0.0,
            field_density=np.round(self._twice_area_in_dbu / 2 * dbu2_um2 / field_um2, 6),
            copies=tuple(each_copy),
            exposure=exposure,
            include=tuple(IncludeFigures(cell.file, cell.cell, cell.counts, cell.texts) for cell in included),
        )

    def _area_dbu(self, bias_dbu: int) -> float:
        """Drawn area of one lens with a bias, squared database units."""
        return int(self._used @ self._twice_area(bias_dbu)) / 2

    def _twice_area(self, bias_dbu: int) -> NDArray[np.int64]:
        """Twice the area of each size with a bias: whole numbers, so that sums are exact in any order."""
        size_dbu = self._map.size_dbu + np.int32(bias_dbu)
        size_dbu[0] = 0
        return np.asarray(np.rint(2.0 * self._outline.area(size_dbu)), dtype=np.int64)


def sidecar(design: Design, figures: MaskFigures, files: Mapping[str, Path]) -> dict[str, Any]:
    """Return the contents of ``layout.json``: provenance, options, figures, and the bytes of each of the ``files``."""
    lattice, mask = lattice_of(design), design.mask
    options: dict[str, Any] = {}
    if mask.bias_nm:
        options["bias_nm"] = mask.bias_nm
    if mask.flat:
        options["flat"] = True
    if mask.dose is not None:
        options["dose"] = mask.dose
    layers = {f"{layer.layer}/0": layer.name for layer in surroundings(design)}
    if layers:
        options["beside"] = layers
    counts = {name: value for name, value in plain(figures).items() if value not in (None, [])}
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
