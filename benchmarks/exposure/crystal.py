"""Wafer rotation: light that sapphire under the paper's lens brings into the wrong image.

Target phases of the paper's lens at a quarter of its aperture, on the axis, over 10 nm. ``error`` is the difference of
the ghost's share from the closed form of a wave plate, sin^2(2 azimuth) times the mean of sin^2(retardance / 2).
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from metafab import layout, optics
from metafab.core.parallel.measure import measured
from metafab.optics.geometry.crystal import Crystal
from metafab.phase import profile_of
from metafab.spec import Substrate, load_design

_DESIGN = Path(__file__).parents[2] / "layouts" / "helix_2mm.toml"
_DEPTH_M, _FILTER_NM, _THICKNESS_UM = 0.30, 10.0, 460.0
_CASES = [("r-plane", azimuth) for azimuth in (0.0, 1.0, 2.0, 5.0, 10.0, 22.5, 45.0)] + [("c-plane", 45.0)]


def rows(quick: bool) -> list[dict[str, Any]]:
    """One row for each cut and azimuth; fewer if ``quick``."""
    design = load_design(_DESIGN)
    design = replace(design, device=replace(design.device, aperture_um=500.0))
    source = optics.ideal_field(profile_of(design), layout.lattice_of(design), design.device)
    numerics = optics.PsfNumerics(window_px=48, target_error=1e-2, filter_fwhm_nm=_FILTER_NM)
    table = []
    for cut, azimuth_deg in _CASES[::3] if quick else _CASES:
        substrate = Substrate(thickness_um=_THICKNESS_UM, cut=cut, azimuth_deg=azimuth_deg)
        imaging = optics.Imaging.of(replace(design, substrate=substrate))
        with measured() as cost:
            pair = optics.psf(source, imaging, [_DEPTH_M], numerics)
        assert pair.ghost is not None
        own, ghost = float(pair.efficiency.mean()), float(pair.ghost.efficiency.mean())
        share = ghost / (own + ghost)
        table.append(
            {
                "name": f"{cut}, azimuth {azimuth_deg:g} degrees",
                "error": abs(share - _closed_form(substrate)),
                "seconds": cost.seconds,
                "peak_rss_mb": cost.peak_rss_mb,
                "efficiency": own,
                "ghost_share": share,
                "extinction_ratio": float(pair.extinction_ratio[0]),
                "contrast_of_2_seen": _seen_contrast(2.0, share),
            }
        )
    return table


def _closed_form(substrate: Substrate) -> float:
    """Crossed share of a wave plate, mean over the filter."""
    half_um = 0.5e-3 * _FILTER_NM
    retardance = [
        (Crystal(substrate, 0.8).at_wavelength(w)).retardance_rad for w in np.linspace(0.8 - half_um, 0.8 + half_um, 41)
    ]
    turned = math.sin(2.0 * math.radians(substrate.azimuth_deg)) ** 2
    return turned * float(np.mean(np.sin(0.5 * np.array(retardance)) ** 2))


def _seen_contrast(contrast: float, share: float) -> float:
    """Contrast of both images for an object of ``contrast``, if nothing separates them."""
    return ((1.0 - share) * contrast + share) / (1.0 - share + share * contrast)
