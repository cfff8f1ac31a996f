"""Lens of the layout and drc benchmarks: the paper's 2 mm lens, or a tenth of it, with a closed-form library.

The way from phases to a checked mask is timed without a solver: phases and amplitudes of the library are smooth
functions of the size, on the paper's grid of 76 x 76 sizes. The gain of a joint choice of sizes is measured with the
solved library of the paper's unit cell.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from metafab import layout, library, phase
from metafab.core.parallel.measure import measured
from metafab.library import Library
from metafab.phase import PhaseProfile
from metafab.spec import Design, UnitCell, load_design

LAYOUTS = Path(__file__).parents[2] / "layouts"
LIBRARY = Path(__file__).parents[2] / "unitcell_lib" / "sos_800nm.h5"

#: Smallest gaps for which sizes are chosen one by one and jointly; the largest size of the library is 250 nm.
GAPS_NM = (110.0, 120.0, 140.0, 160.0, 180.0)


def lens_design(quick: bool) -> Design:
    """Return the paper's lens, or the small one if ``quick``, with the zones of Eq. 2 and without optimisation."""
    design = load_design(LAYOUTS / ("helix_small.toml" if quick else "helix_2mm.toml"))
    terms = (replace(term, optimise="none") if hasattr(term, "optimise") else term for term in design.phase)
    return replace(design, phase=tuple(terms))


def lens_profile(design: Design) -> PhaseProfile:
    """Return the target phases of the lens."""
    return phase.profile_of(design)


def closed_form_library(unit_cell: UnitCell) -> Library:
    """Return a library whose phases span 1.3 turns, mostly by the parallel side; amplitudes dip for large pillars."""
    sweep = unit_cell.sweep
    count = round((sweep.width_nm[1] - sweep.width_nm[0]) / sweep.size_grid_nm) + 1
    side_nm = np.linspace(*sweep.width_nm, count)
    own = np.linspace(0.0, 1.0, count)
    width, length = own[None, :], own[:, None]
    amplitude = 1.25 * (1.0 - 0.15 * width * length)
    t_xx = (amplitude * np.exp(2.6j * np.pi * (0.8 * width + 0.2 * length)))[None]
    t_yy = (amplitude * np.exp(2.6j * np.pi * (0.8 * length + 0.2 * width)))[None]
    r = np.full_like(t_xx, 0.1)
    wavelength_nm = np.array([unit_cell.illumination.wavelength_nm])
    error = np.full(t_xx.shape, 1e-3)
    return Library(unit_cell, wavelength_nm, side_nm, side_nm.copy(), t_xx, t_yy, r, r.copy(), error, "closed form")


def gap_rows(quick: bool) -> list[dict[str, Any]]:
    """Return rows of the small lens, and of the paper's unless ``quick``; ``error`` is the rms phase error, rad."""
    solved = library.load(LIBRARY)
    cases = [(True, gap_nm) for gap_nm in GAPS_NM] + ([] if quick else [(False, 140.0)])
    table = []
    for small, gap_nm in cases:
        design = lens_design(small)
        profile = lens_profile(design)
        for rule in ("each", "pairs"):
            rules = replace(design.rules, min_gap_nm=gap_nm, gap_rule=rule)
            with measured() as cost:
                figures = layout.assign(profile, solved, replace(design, rules=rules)).figures
            table.append(
                {
                    "name": f"mapping by {rule}, gap {gap_nm:g} nm, {design.device.aperture_um:g} um",
                    "series": f"mapping by {rule}, gaps {GAPS_NM[0]:g} to {GAPS_NM[-1]:g} nm",
                    "error": figures.phase_rms_error_rad,
                    **vars(cost),
                    "pillars": figures.pillars,
                    "mean_transmittance": figures.mean_transmittance,
                    "efficiency": figures.efficiency,
                    "min_gap_nm": figures.min_gap_nm,
                }
            )
    return table
