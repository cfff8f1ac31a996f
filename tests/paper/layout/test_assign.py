"""What Shen et al. (Nature Communications 14, 1035, 2023) say of their metasurface, on a written and reread mask."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab import drc, layout, mask, phase
from metafab.library import Library
from metafab.spec import Design, load_design
from tests.conftest import ROOT


@pytest.fixture(scope="module")
def paper_design() -> Design:
    """The paper's lens; its zones unoptimised, which the layout does not care about."""
    design = load_design(ROOT / "layouts" / "helix_2mm.toml")
    terms = (replace(term, optimise="none") if hasattr(term, "optimise") else term for term in design.phase)
    return replace(design, phase=tuple(terms))


def test_unit_cell_and_aperture(paper_design: Design) -> None:
    """Methods: U = 350 nm, aperture 2 mm: pi (1 mm)^2 / (350 nm)^2 is 25.6 million pillars."""
    lattice = layout.lattice_of(paper_design)
    assert lattice.period_dbu == (700, 700)
    assert layout.Aperture.of(paper_design).count == pytest.approx(25.6e6, abs=0.05e6)


def test_sizes_and_gaps_on_the_written_mask(paper_design: Design, smooth_library: Library, tmp_path: Path) -> None:
    """Fig. 2c: W and L between 100 and 250 nm; text: gaps over 100 nm. On the inner 60 um, from the file."""
    inner = replace(paper_design, device=replace(paper_design.device, aperture_um=60.0))
    assignment = layout.assign(phase.profile_of(inner), smooth_library, inner)
    mask.write(assignment.pillars, tmp_path, inner)
    for suffix in ("gds", "oas"):
        report = drc.check(tmp_path / f"layout.{suffix}", inner)
        assert report.clean
        assert report.min_gap_nm is not None
        assert report.min_gap_nm >= 100.0
        pillars = mask.read(tmp_path / f"layout.{suffix}", inner).pillars
        size_nm = pillars.size_nm()[1:]
        assert size_nm.min() >= 100.0
        assert size_nm.max() <= 250.0


def test_both_phases_are_reached_independently(paper_design: Design, smooth_library: Library) -> None:
    """Text: independent control over the full 2 pi of both polarisations.

    Random targets would err by pi / sqrt(3) = 1.8 rad rms; with a library of 1.3 turns in each polarisation, of
    which the corner (small, large) is cut off, the rms must stay below a tenth of that.
    """
    inner = replace(paper_design, device=replace(paper_design.device, aperture_um=60.0))
    figures = layout.assign(phase.profile_of(inner), smooth_library, inner).figures
    assert figures.phase_rms_error_rad < 0.1 * math.pi / np.sqrt(3.0)
    assert figures.field_overlap > 0.97
