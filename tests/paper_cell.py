"""The paper's unit cell as numbers, for tests of solvers that read no files."""

from __future__ import annotations

from dataclasses import replace

from metafab.cell import PillarCell

#: Silicon of 600 nm on sapphire at 800 nm; a size on the flank of a resonance.
SILICON = PillarCell(
    period_nm=(350.0, 350.0),
    width_nm=150.0,
    length_nm=210.0,
    height_nm=600.0,
    n_pillar=3.6941 + 0.0065j,
    n_substrate=(1.7601, 1.7601),
    n_ambient=1.0,
    wavelength_nm=800.0,
)
#: The same cell without its pillar.
EMPTY = replace(SILICON, width_nm=0.0, length_nm=0.0)
#: The same pillar without its loss, so that power has nowhere else to go.
LOSSLESS = replace(SILICON, n_pillar=3.6941)
