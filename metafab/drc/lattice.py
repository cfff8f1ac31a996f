"""Design rules on the pillars read back from a file: exact, in whole database units, a band of rows at a time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import sha256
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.parallel.executor import in_order, open_threads
from metafab.core.parallel.progress import Progress, silent
from metafab.drc.report import MARKERS, RULES, DrcReport, Marker, refuse_several_tops, upright_side_nm
from metafab.layout import Aperture, Outline, smallest_gap
from metafab.layout.pillars import SizeIndexArray
from metafab.mask import ReadBack
from metafab.mask.drawing.scan import count_sizes
from metafab.spec import Design

_BAND_ROWS = 256

# Rules compare with limits from the design file, which are decimal; a millionth of a unit is no violation.
_SLACK_DBU = 1e-6


@dataclass
class _Findings:
    """Violations of one band."""

    counts: dict[str, int]
    boxes_nm: dict[str, list[FloatArray]]
    smallest_gap_dbu: float

    def add(self, rule: str, count: int, boxes_nm: FloatArray) -> None:
        """Count violations of a rule and keep the first places."""
        self.counts[rule] += count
        if count:
            self.boxes_nm[rule].append(boxes_nm[:MARKERS])


def _nothing(design: Design) -> _Findings:
    rules = [rule for rule in RULES if rule != "aspect_ratio" or design.rules.max_aspect_ratio is not None]
    return _Findings(dict.fromkeys(rules, 0), {rule: [] for rule in rules}, np.inf)


def check_lattice(
    read_back: ReadBack,
    design: Design,
    workers: int | None = None,
    progress: Progress = silent,
    cluster: str | None = None,
) -> DrcReport:
    """All rules of :data:`RULES` on what was read from a file.

    Gaps are those between pillars on their sites. What stands elsewhere is a violation by itself and its gaps are not
    checked; the smallest gap is then left open.

    Args:
        read_back: the file's content.
        design: rules, aperture.
        workers: threads; the cores unless given.
        progress: told about rows.
        cluster: address of a Dask scheduler whose workers check the bands.

    Raises:
        InputError: the file has several top cells.
    """
    refuse_several_tops(read_back.path, read_back.top_cells)
    size_index = read_back.pillars.to_array()
    total = _of_leftovers(read_back, design)
    # Of the other copies nothing but the count is looked at: every site inside the aperture has a pillar.
    sites = Aperture.of(design).count if read_back.other_copies else 0
    total.counts["missing"] += sum(max(0, sites - count) for count in read_back.other_copies.values())
    n_y = len(size_index)
    with open_threads(workers, cluster) as executor:
        rules = _BandRules(read_back, design)
        for done, findings in enumerate(in_order(executor, rules, _bands(size_index)), start=1):
            for rule in total.counts:
                total.counts[rule] += findings.counts[rule]
                total.boxes_nm[rule] += findings.boxes_nm[rule]
            total.smallest_gap_dbu = min(total.smallest_gap_dbu, findings.smallest_gap_dbu)
            progress("rules", min(done * _BAND_ROWS, n_y), n_y)
    on_sites = int(np.count_nonzero(size_index))
    stray = read_back.off_site.count + read_back.off_grid.count + read_back.duplicates.count
    measured = np.isfinite(total.smallest_gap_dbu) and not stray
    return DrcReport(
        file=read_back.path.name,
        engine="lattice",
        pillars=on_sites + stray,
        violations=total.counts,
        markers={rule: tuple(_markers(total.boxes_nm[rule])) for rule, count in total.counts.items() if count},
        min_gap_nm=float(total.smallest_gap_dbu * design.mask.database_unit_nm) if measured else None,
        other_layers=read_back.other_layers,
        other_copies=read_back.other_copies,
        pillars_sha256=_pillars_sha256(read_back.pillars.size_dbu, size_index),
    )


def _pillars_sha256(size_dbu: NDArray[np.int32], size_index: SizeIndexArray) -> str:
    """Of sizes and their places; a read-back sorts its sizes, so equal masks have equal indices."""
    digest = sha256(np.ascontiguousarray(size_dbu).data)
    digest.update(np.ascontiguousarray(size_index).data)
    return digest.hexdigest()


def _markers(boxes_nm: list[FloatArray]) -> Iterator[Marker]:
    if boxes_nm:
        for box in np.concatenate(boxes_nm)[:MARKERS].tolist():
            yield Marker(*box)


def _of_leftovers(read_back: ReadBack, design: Design) -> _Findings:
    """Violations that the reader has already set apart."""
    found = _nothing(design)
    kinds = {"lattice_site": read_back.off_site, "grid": read_back.off_grid, "duplicate": read_back.duplicates}
    for rule, leftover in kinds.items():
        found.add(rule, leftover.count, leftover.boxes_nm)
        for narrow, column in (("min_width", 2), ("min_length", 3)):
            below = leftover.boxes_nm[:, column] < design.rules.min_feature_nm - _SLACK_DBU
            found.add(narrow, int(np.count_nonzero(below)), leftover.boxes_nm[below])
    # A second rectangle at a site lies on the first.
    found.add("overlap", read_back.duplicates.count, read_back.duplicates.boxes_nm)
    for shapes in read_back.foreign.values():
        found.add("foreign", shapes.count, shapes.boxes_nm)
    return found


class _Band(NamedTuple):
    """Some rows of sites.

    Attributes:
        row: the first of them.
        size_index: shape (rows, n_x).
        and_next: the same rows and, if there is one, the row after them.
    """

    row: int
    size_index: SizeIndexArray
    and_next: SizeIndexArray


def _bands(size_index: SizeIndexArray) -> Iterator[_Band]:
    for row in range(0, len(size_index), _BAND_ROWS):
        and_next = size_index[row : row + _BAND_ROWS + 1]
        yield _Band(row, and_next[:_BAND_ROWS], and_next)


class _BandRules:
    """Rules on the pillars at their sites, a band at a time."""

    def __init__(self, read_back: ReadBack, design: Design) -> None:
        pillars = read_back.pillars
        self._lattice = pillars.lattice
        self._at_nm = np.array(read_back.at_nm)
        self._size_dbu = pillars.size_dbu
        self._outline = Outline.of(design)
        self._size_nm = pillars.size_nm()
        self._aperture = Aperture.of(design)
        self._design = design
        unit_nm = pillars.lattice.database_unit_nm
        self._gap_dbu = design.rules.min_gap_nm / unit_nm - _SLACK_DBU
        too_small = self._size_dbu < design.rules.min_feature_nm / unit_nm - _SLACK_DBU
        self._too_small = {"min_width": too_small[:, 0], "min_length": too_small[:, 1]}
        upright_nm = upright_side_nm(design)
        if upright_nm is not None:
            self._too_small["aspect_ratio"] = self._size_dbu.min(axis=1) < upright_nm / unit_nm - _SLACK_DBU

    def __call__(self, band: _Band) -> _Findings:
        """All rules for the rows of a band; pairs with the row above the band belong to it."""
        found = _nothing(self._design)
        used = count_sizes(band.size_index, len(self._size_dbu))
        for rule, bad in self._too_small.items():
            count = int(used[1:] @ bad[1:])
            if count:
                row, column = np.nonzero(bad[band.size_index] & (band.size_index > 0))
                found.add(rule, count, self._boxes(band, row[:MARKERS], column[:MARKERS]))
        self._check_aperture(band, found)
        self._check_gaps(band, found)
        return found

    def _check_aperture(self, band: _Band, found: _Findings) -> None:
        inside = self._aperture.inside(band.row, 0, band.size_index.shape)
        wrong = inside != (band.size_index > 0)
        if wrong.any():
            for rule, bad in (("aperture", wrong & ~inside), ("missing", wrong & inside)):
                row, column = np.nonzero(bad)
                found.add(rule, row.size, self._boxes(band, row[:MARKERS], column[:MARKERS]))

    def _check_gaps(self, band: _Band, found: _Findings) -> None:
        gaps = smallest_gap(
            band.and_next, self._size_dbu, self._lattice, self._gap_dbu, len(band.size_index), self._outline
        )
        found.smallest_gap_dbu = gaps.smallest_dbu
        if gaps.below:
            row, column = np.divmod(gaps.too_small, band.and_next.shape[1])
            down, right = np.array(self._lattice.pairs)[gaps.neighbour].T
            here = self._boxes(band, row, column)
            there = self._boxes(band, row + down, column + right)
            low = np.minimum(here[:, :2], there[:, :2])
            high = np.maximum(here[:, :2] + here[:, 2:], there[:, :2] + there[:, 2:])
            boxes = np.concatenate([low, high - low], axis=1)
            found.add("min_gap", gaps.below, boxes)
            found.add("overlap", gaps.overlapping, boxes)

    def _boxes(self, band: _Band, row: NDArray[np.int64], column: NDArray[np.int64]) -> FloatArray:
        """The pillar at each site, or its unit cell where there is none: x, y, width, height in nm.

        Rows are counted from the band's first.
        """
        size = self._size_nm[band.and_next[row, column]]
        cell = np.multiply(self._lattice.cell_dbu, self._lattice.database_unit_nm, dtype=np.float64)
        size = np.where(size > 0, size, cell)
        centre = (
            np.stack([self._lattice.x_um()[column], self._lattice.y_um()[band.row + row]], axis=1) * 1e3 + self._at_nm
        )
        return np.concatenate([centre - size / 2.0, size], axis=1)
