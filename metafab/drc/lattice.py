"""Design rules on the pillars read back from a file: exact, in whole database units, a band of rows at a time."""

from __future__ import annotations

from collections.abc import Iterator
from hashlib import sha256
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.parallel.executor import in_order
from metafab.core.parallel.work import Work
from metafab.drc.report import MARKERS, DrcReport, Findings, spanning_boxes
from metafab.drc.rules import RULES, Limits, require_one_top, rules_in
from metafab.layout import Aperture, Outline, PillarMap, smallest_gap
from metafab.layout.pillars import SizeIndexArray
from metafab.mask import ReadBack
from metafab.mask.drawing.scan import count_sizes
from metafab.spec import Design

if TYPE_CHECKING:
    from hashlib import _Hash

#: Rows of sites that are checked at a time.
_BAND_ROWS = 256


def check_lattice(read_back: ReadBack, design: Design, work: Work = Work()) -> DrcReport:
    """Check all rules of :data:`RULES` on the contents of a file; InputError if it has several top cells.

    Gaps are those between pillars on their sites. A pillar elsewhere is a violation by itself and its gaps are not
    checked; the smallest gap of the report is then None. Bands of rows are checked by the threads or the cluster of
    ``work``.
    """
    require_one_top(read_back.path, read_back.top_cells)
    pillars, digest = read_back.pillars, sha256()
    findings, smallest_dbu, count = _check_leftovers(read_back, design), np.inf, 0
    # The other copies are only counted: every site inside the aperture has a pillar.
    sites = Aperture.of(design).count if read_back.other_copies else 0
    findings.counts["missing"] += sum(max(0, sites - found) for found in read_back.other_copies.values())
    n_y = pillars.lattice.shape[0]
    # Sizes of a read-back are sorted, so that equal masks have equal indices, and one hash of sizes and places.
    digest.update(np.ascontiguousarray(pillars.size_dbu).data)
    with work.threads() as executor:
        rules = _BandRules(read_back, design)
        for done, of_band in enumerate(in_order(executor, rules, _bands(pillars, digest)), start=1):
            findings.merge(of_band.findings)
            smallest_dbu = min(smallest_dbu, of_band.gap_dbu)
            count += of_band.pillars
            work.progress("rules", min(done * _BAND_ROWS, n_y), n_y)
    stray = read_back.off_site.count + read_back.off_grid.count + read_back.duplicates.count
    measured = np.isfinite(smallest_dbu) and not stray
    return DrcReport(
        file=read_back.path.name,
        engine="lattice",
        pillars=count + stray,
        violations=findings.counts,
        markers=findings.markers(),
        min_gap_nm=float(smallest_dbu * design.mask.database_unit_nm) if measured else None,
        other_layers=read_back.other_layers,
        other_copies=read_back.other_copies,
        stands_at_um=read_back.stands_at_um,
        pillars_sha256=digest.hexdigest(),
    )


def _check_leftovers(read_back: ReadBack, design: Design) -> Findings:
    """Violations that the reader has already set apart."""
    findings, smallest_nm = Findings(rules_in(design, RULES)), Limits.of(design, unit_nm=1.0).side
    leftovers = {"lattice_site": read_back.off_site, "grid": read_back.off_grid, "duplicate": read_back.duplicates}
    for rule, leftover in leftovers.items():
        findings.add(rule, leftover.boxes_nm, leftover.count)
        for narrow, column in (("min_width", 2), ("min_length", 3)):
            findings.add(narrow, leftover.boxes_nm[leftover.boxes_nm[:, column] < smallest_nm])
    # A second rectangle at a site lies on the first.
    findings.add("overlap", read_back.duplicates.boxes_nm, read_back.duplicates.count)
    for shapes in read_back.foreign.values():
        findings.add("foreign", shapes.boxes_nm, shapes.count)
    return findings


class _Band(NamedTuple):
    """Some rows of sites."""

    row: int  #: The first of these rows.
    size_index: SizeIndexArray  #: Shape (rows, n_x).
    #: Shape (rows + 1, n_x), the rows and the next one; at the end of the lattice only the rows.
    and_next: SizeIndexArray


class _Checked(NamedTuple):
    """Result of a band."""

    findings: Findings  #: Violations.
    gap_dbu: float  #: Smallest gap, the pairs with the next row included.
    pillars: int  #: Number of pillars.


def _bands(pillars: PillarMap, digest: _Hash) -> Iterator[_Band]:
    """All bands; their indices are added to the digest."""
    for row, and_next in pillars.bands(_BAND_ROWS):
        band = _Band(row, and_next[:_BAND_ROWS], and_next)
        digest.update(np.ascontiguousarray(band.size_index).data)
        yield band


class _BandRules:
    """Rules on the pillars at their sites, a band at a time."""

    def __init__(self, read_back: ReadBack, design: Design) -> None:
        pillars = read_back.pillars
        self._lattice = pillars.lattice
        self._at_nm = np.array(read_back.at_nm)
        self._size_dbu, self._size_nm = pillars.size_dbu, pillars.size_nm()
        self._outline = Outline.of(design)
        self._aperture = Aperture.of(design)
        self._rules = rules_in(design, RULES)
        limits = Limits.of(design, pillars.lattice.database_unit_nm)
        self._gap_dbu = limits.gap
        walls, holes = self._outline.walls_and_holes(self._size_dbu)
        self._too_small = {
            "min_width": walls[:, 0] < limits.side,
            "min_length": walls[:, 1] < limits.side,
            "min_gap": holes < limits.gap,
        }
        if limits.upright is not None:
            self._too_small["aspect_ratio"] = walls.min(axis=1) < limits.upright

    def __call__(self, band: _Band) -> _Checked:
        """Check a band."""
        findings = Findings(self._rules)
        used = count_sizes(np.ascontiguousarray(band.size_index), len(self._size_dbu))
        for rule, bad in self._too_small.items():
            count = int(used[1:] @ bad[1:])
            if count:
                row, column = np.nonzero(bad[band.size_index] & (band.size_index > 0))
                findings.add(rule, self._boxes(band, row[:MARKERS], column[:MARKERS]), count)
        self._check_aperture(band, findings)
        return _Checked(findings, self._check_gaps(band, findings), int(used[1:].sum()))

    def _check_aperture(self, band: _Band, findings: Findings) -> None:
        inside = self._aperture.inside(band.row, 0, band.size_index.shape)
        filled = band.size_index > 0
        for rule, bad in (("aperture", filled & ~inside), ("missing", inside & ~filled)):
            if bad.any():
                row, column = np.nonzero(bad)
                findings.add(rule, self._boxes(band, row[:MARKERS], column[:MARKERS]), row.size)

    def _check_gaps(self, band: _Band, findings: Findings) -> float:
        """Apply the gap rule; return the smallest gap."""
        gaps = smallest_gap(
            band.and_next, self._size_dbu, self._lattice, self._gap_dbu, len(band.size_index), self._outline
        )
        if gaps.below:
            row, column = np.divmod(gaps.too_small, band.and_next.shape[1])
            down, right = np.array(self._lattice.pairs)[gaps.neighbour].T
            boxes = spanning_boxes(self._boxes(band, row, column), self._boxes(band, row + down, column + right))
            findings.add("min_gap", boxes, gaps.below)
            if gaps.overlapping:
                findings.add("overlap", boxes, gaps.overlapping)
        return gaps.smallest_dbu

    def _boxes(self, band: _Band, row: NDArray[np.int64], column: NDArray[np.int64]) -> FloatArray:
        """Boxes in nm, shape (n, 4), of the pillars at some sites, or of the unit cells where there are none.

        Rows, shape (n,), are counted from the first of the band.
        """
        size = self._size_nm[band.and_next[row, column]]
        cell = np.multiply(self._lattice.cell_dbu, self._lattice.database_unit_nm, dtype=np.float64)
        size = np.where(size > 0, size, cell)
        site_um = np.stack([self._lattice.x_um()[column], self._lattice.y_um()[band.row + row]], axis=1)
        return np.concatenate([site_um * 1e3 + self._at_nm - size / 2.0, size], axis=1)
