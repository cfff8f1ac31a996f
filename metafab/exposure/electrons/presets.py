"""Beam point-spread functions of usual processes, simulated by :mod:`metafab.exposure.electrons.monte_carlo`.

The tables in ``tables/`` are results of :func:`simulated`. Thickness and density of the resist are assumptions, stated
here. A function measured on the writer and resist in use replaces them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib import resources

import numpy as np

from metafab.core.errors import InputError
from metafab.exposure.electrons.beam import BeamPsf
from metafab.exposure.electrons.monte_carlo import (
    ALUMINIUM,
    HSQ,
    PMMA,
    SAPPHIRE,
    SILICA,
    SILICON,
    ZEP,
    ElectronHistogram,
    Layer,
    simulate,
)

_SILICON_ON_SAPPHIRE = (Layer(SILICON, 2.329, 600.0), Layer(SAPPHIRE, 3.98, math.inf))
_HSQ_300 = Layer(HSQ, 1.4, 300.0)


@dataclass(frozen=True)
class Preset:
    """A process."""

    stack: tuple[Layer, ...]  #: Layers from the resist down.
    beam_kev: float  #: Energy of the electrons.
    description: str  #: The stack in words, with its assumptions.
    resist: int = 0  #: Number of the resist's layer, from 0.


PRESETS = {
    "hsq_sos_100kv": Preset(
        (_HSQ_300, *_SILICON_ON_SAPPHIRE),
        100.0,
        "HSQ (300 nm, 1.4 g/cm3: assumed) on 600 nm silicon on sapphire, 100 kV",
    ),
    "hsq_sos_50kv": Preset(
        (_HSQ_300, *_SILICON_ON_SAPPHIRE),
        50.0,
        "HSQ (300 nm, 1.4 g/cm3: assumed) on 600 nm silicon on sapphire, 50 kV",
    ),
    "pmma_si_100kv": Preset(
        (Layer(PMMA, 1.18, 200.0), Layer(SILICON, 2.329, math.inf)),
        100.0,
        "PMMA (200 nm, 1.18 g/cm3: assumed) on silicon, 100 kV",
    ),
    "zep_si_100kv": Preset(
        (Layer(ZEP, 1.11, 300.0), Layer(SILICON, 2.329, math.inf)),
        100.0,
        "ZEP (300 nm, 1.11 g/cm3: assumed) on silicon, 100 kV",
    ),
    "pmma_fused_silica_100kv": Preset(
        (Layer(ALUMINIUM, 2.7, 10.0), Layer(PMMA, 1.18, 200.0), Layer(SILICA, 2.2, math.inf)),
        100.0,
        "aluminium (10 nm: assumed) on PMMA (200 nm, 1.18 g/cm3: assumed) on fused silica, 100 kV",
        resist=1,
    ),
}


def preset(name: str) -> BeamPsf:
    """Return the point-spread function of a preset; InputError for no preset of that name."""
    if name not in PRESETS:
        raise InputError.single("exposure", "preset", f"one of {', '.join(PRESETS)}", repr(name))
    text = (resources.files("metafab.exposure.electrons") / "tables" / f"{name}.csv").read_text(encoding="utf-8")
    rows = np.loadtxt(text.splitlines(), delimiter=",", skiprows=1)
    return BeamPsf.fitted(rows[:, 0], rows[:, 1], f"Monte Carlo by metafab: {PRESETS[name].description}")


def simulated(name: str) -> ElectronHistogram:
    """Simulate the table of a preset again."""
    chosen = PRESETS[name]
    return simulate(chosen.stack, chosen.beam_kev, 60_000, resist=chosen.resist)
