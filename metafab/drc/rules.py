"""The design rules, and their limits in units of a file."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from metafab.core.errors import InputError
from metafab.spec import Design

RULES = {
    "min_width": "a pillar, or the wall of a ring, narrower along x than `rules.min_feature_nm`",
    "min_length": "a pillar, or the wall of a ring, shorter along y than `rules.min_feature_nm`",
    "aspect_ratio": "a pillar whose shorter side is below its height over `rules.max_aspect_ratio`",
    "min_gap": "two pillars nearer than `rules.min_gap_nm`, diagonal neighbours included, or a narrower hole",
    "overlap": "two pillars that overlap or touch",
    "grid": "edges that are not a whole number of database units",
    "lattice_site": "a rectangle whose centre is not a site of the lattice, or that is larger than a unit cell",
    "aperture": "a pillar whose unit cell is not inside the aperture",
    "duplicate": "a second rectangle at a site",
    "missing": "a site inside the aperture without a pillar",
    "foreign": "a shape on the pillar layer that is not an axis-parallel rectangle",
}

#: Limits in the design file are decimal; a violation of less than a millionth of a unit is rounding.
SLACK_DBU = 1e-6


@dataclass(frozen=True)
class Limits:
    """Limits of sides and gaps in file units; a side or gap below its limit is a violation."""

    side: float  #: Smallest width and length.
    upright: float | None  #: Smallest length of the shorter side by ``rules.max_aspect_ratio``; None without that rule.
    gap: float  #: Smallest distance.

    @classmethod
    def of(cls, design: Design, unit_nm: float) -> Limits:
        """Return the limits of a design in units of ``unit_nm``."""
        upright_nm = upright_side_nm(design)
        return cls(
            design.rules.min_feature_nm / unit_nm - SLACK_DBU,
            None if upright_nm is None else upright_nm / unit_nm - SLACK_DBU,
            design.rules.min_gap_nm / unit_nm - SLACK_DBU,
        )


def upright_side_nm(design: Design) -> float | None:
    """Shortest drawn side that ``rules.max_aspect_ratio`` allows, nm; None without that rule."""
    ratio = design.rules.max_aspect_ratio
    return None if ratio is None else design.unit_cell.cell.height_nm / ratio + design.mask.bias_nm


def rules_in(design: Design, visible: Collection[str]) -> list[str]:
    """Return the rules of a design among those ``visible`` to an engine."""
    limited = design.rules.max_aspect_ratio is not None
    return [rule for rule in RULES if rule in visible and (limited or rule != "aspect_ratio")]


def require_one_top(path: Path, top_cells: Sequence[str]) -> None:
    """Raise InputError for a file that does not have one top cell."""
    if len(top_cells) != 1:
        names = ", ".join(map(repr, sorted(top_cells)[:5]))
        got = f"{len(top_cells)}: {names}"
        raise InputError.single(str(path), "cells", "one top cell", got, "write the mask again")


def require_shapes(path: Path, design: Design, shapes: int) -> None:
    """Raise InputError for an empty pillar layer, on which an engine without a lattice would find no violation."""
    if shapes == 0:
        first, last = design.mask.datatypes
        layer = f"{design.mask.layer}/{first}" + (f" to {last}" if last > first else "")
        remedy = "are `mask.layer` and `mask.datatype` those of the file?"
        raise InputError.single(str(path), "pillars", f"shapes on layer {layer}", "none", remedy)
