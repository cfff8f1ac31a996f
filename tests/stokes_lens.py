"""Full-Stokes siblings of the small lens, and their PSFs with perfect pillars."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from metafab.layout import lattice_of
from metafab.optics import Imaging, ideal_field
from metafab.optics.polarisation_states import StokesPsf, stokes_psf
from metafab.phase.jones_target import JonesTarget
from metafab.spec import Design, load_design

#: Angle between rows of images: that of the small lens' split.
ROW_ANGLE_DEG = 8.0
SMALL = Path(__file__).parent.parent / "layouts" / "helix_small.toml"


def whole_lens() -> Design:
    """The small lens with the plain helix of Eq. 2, which takes no time to optimise."""
    design = load_design(SMALL)
    terms = tuple(dataclasses.replace(t, optimise="none") if hasattr(t, "optimise") else t for t in design.phase)
    return dataclasses.replace(design, phase=terms)


def quarter_lens() -> Design:
    """A quarter of the small lens' aperture, with room for turned pillars."""
    design = whole_lens()
    device = dataclasses.replace(design.device, aperture_um=50.0)
    rules = dataclasses.replace(design.rules, min_gap_nm=60.0)
    return dataclasses.replace(design, device=device, rules=rules)


def hexagonal_lens() -> Design:
    """The quarter lens on a hexagonal lattice of the same period."""
    design = quarter_lens()
    cell = dataclasses.replace(design.unit_cell.cell, lattice="hexagonal", period_nm=350.0)
    return dataclasses.replace(design, unit_cell=dataclasses.replace(design.unit_cell, cell=cell))


def perfect_psf(design: Design, depths_m: Sequence[float], window_px: int) -> StokesPsf:
    """PSFs of a design's target with perfect pillars."""
    target = JonesTarget.of(design, ROW_ANGLE_DEG)
    source = ideal_field(target, lattice_of(design), design.device)
    return stokes_psf(source, target, Imaging.of(design), depths_m, window_px=window_px)
