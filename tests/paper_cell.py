"""The paper's unit cell as numbers, for tests of solvers that read no files."""

from __future__ import annotations

from dataclasses import replace

from metafab.cell import PillarCell

#: Silicon of 600 nm on sapphire at 800 nm; a size on the flank of a resonance.
SILICON = PillarCell((350.0, 350.0), 150.0, 210.0, 600.0, 3.6941 + 0.0065j, (1.7601, 1.7601), 1.0, 800.0)
#: The same cell without its pillar.
EMPTY = replace(SILICON, width_nm=0.0, length_nm=0.0)
#: The same pillar without its loss, so that power has nowhere else to go.
LOSSLESS = replace(SILICON, n_pillar=3.6941)
