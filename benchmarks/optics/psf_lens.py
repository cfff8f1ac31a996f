"""Lens of the PSF benchmarks: Eqs. 2 to 4 of Shen 2023 in 30 x 30 phase levels at 90 % amplitude, of any aperture.

No library is solved and no mask is written, so that only the optics room is measured.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from metafab.layout.geometry import lattice_of
from metafab.layout.pillars import PillarMap
from metafab.optics import Imaging, WrittenField
from metafab.phase import SpiralZonesPhase, SplitLensPhase
from metafab.spec import Design, load_design

LAYOUTS = Path(__file__).parents[2] / "layouts"
LEVELS = 30


def lens_design(aperture_um: float) -> Design:
    """Return the paper's 2 mm lens, with focal length and depths scaled to the aperture."""
    design = load_design(LAYOUTS / "helix_2mm.toml")
    scale = aperture_um / design.device.aperture_um
    device = replace(design.device, aperture_um=aperture_um, focal_length_mm=scale * design.device.focal_length_mm)
    sensor = replace(design.sensor, focus_depth_m=scale * design.sensor.focus_depth_m)
    verify = replace(design.verify, depths_m=tuple(scale * depth for depth in design.verify.depths_m))
    return replace(design, device=device, sensor=sensor, verify=verify, scene=None)


def lens_field(design: Design, imaging: Imaging) -> WrittenField:
    """Return the pillars of the lens with the amplitude of each pair of levels."""
    lattice = lattice_of(design)
    x, y = lattice.x_um(), lattice.y_um()
    radius = 0.5 * design.device.aperture_um
    terms = (
        SpiralZonesPhase(zones=4, exponent=0.5, radius_um=radius),
        SplitLensPhase(
            wavelength_um=imaging.wavelength_um,
            image_distance_um=1e3 * imaging.focal_length_mm,
            angle_deg=imaging.split_angle_deg,
        ),
    )
    index = np.zeros(lattice.shape, dtype=np.uint16)
    for row in range(0, y.size, 256):
        part = slice(row, row + 256)
        levels = [
            np.rint(sum(t(x, y[part], p) for t in terms) / (2.0 * np.pi) * LEVELS).astype(np.int64) % LEVELS
            for p in ("x", "y")
        ]
        inside = np.hypot(x[None, :], y[part, None]) <= radius
        index[part] = np.where(inside, 1 + levels[0] + LEVELS * levels[1], 0)
    phasor = np.exp(2j * np.pi * np.arange(LEVELS) / LEVELS)
    table = np.zeros((LEVELS * LEVELS + 1, 2), dtype=np.complex128)
    table[1:, 0], table[1:, 1] = 0.9 * np.tile(phasor, LEVELS), 0.9 * np.repeat(phasor, LEVELS)
    pillars = PillarMap.from_array(lattice, np.zeros((table.shape[0], 2), np.int32), index, 286)
    return WrittenField(pillars, table)
