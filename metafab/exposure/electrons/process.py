"""Point-spread function of the beam for the ``[process.exposure]`` of a design, and those of usual processes.

The tables in ``tables/`` are results of :func:`simulated`. Thickness and density of the resist are assumptions, stated
here. A function measured on the writer and resist in use replaces them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Literal

import numpy as np

from metafab.core.arguments import require_types
from metafab.core.conventions import FloatArray
from metafab.core.errors import Fault, InputError
from metafab.core.storage.limits import require_modest_table
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
from metafab.spec import Design
from metafab.spec.mask import ExposureProcess

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


def beam_psf(process: ExposureProcess, focus_um: float | None = None) -> BeamPsf:
    """Build the function from a preset, terms or a table, with the process' blur, at a focus (None for the best one).

    InputError for an unknown preset, an unreadable table, a ratio for a function without backscattered part, or a beam
    out of focus without its convergence.
    """
    require_types("exposure", process=(process, ExposureProcess))
    if process.preset is not None:
        plain = preset(process.preset)
        if process.source != ExposureProcess.source:
            plain = replace(plain, source=f"{plain.source}; {process.source}")
    elif process.terms:
        plain = BeamPsf.of(process.terms, process.source)
    else:
        plain = _from_table(process)
    if process.backscatter_ratio is not None:
        plain = plain.with_backscatter(process.backscatter_ratio)
    if focus_um is None or focus_um == process.best_focus_um:
        return plain.blurred(process.blur_nm)
    if process.convergence_mrad is None:
        expected = f"the half angle of the beam, for a focus of {focus_um:g} um"
        remedy = "state it; `metafab process fit --free convergence` finds it from a focus-dose matrix"
        raise InputError.single("process.exposure", "convergence_mrad", expected, "none", remedy)
    defocus_um = np.array(focus_um - process.best_focus_um)
    return plain.blurred(float(blur_out_of_focus_nm(process.blur_nm, process.convergence_mrad, defocus_um)))


def blur_out_of_focus_nm(blur_nm: float, convergence_mrad: float, defocus_um: FloatArray) -> FloatArray:
    """Range of the blur of a beam out of focus, in the shape of ``defocus_um``.

    A cone of the half angle ``convergence_mrad``, evenly filled, is a disc of the radius angle times defocus. Its rms
    radius, 1 / sqrt(2) of that, is the range of the Gaussian of equal second moment, and adds to the blur in
    quadrature.
    """
    return np.asarray(np.hypot(blur_nm, convergence_mrad * defocus_um / math.sqrt(2.0)))


def _from_table(process: ExposureProcess) -> BeamPsf:
    """Fit Gaussians to the table of a text file.

    Numbers are separated by commas, semicolons, tabs or spaces; lines before the first row of numbers are headers, as
    CASINO, BEAMER and TRACER write them.
    """
    path = process.table_file
    assert path is not None
    header, rows = _table(path)
    unit = process.table_unit or _unit_of(header)
    if unit is None:
        expected = "'nm' or 'um', here or in the header of the table"
        raise InputError.single(str(path), "table_unit", expected, "none", 'add `table_unit = "um"` or "nm"')
    radius_nm, energy = rows[:, 0] * (1e3 if unit == "um" else 1.0), rows[:, 1]
    if process.table_energy == "ring":
        edges = np.concatenate([[0.0], radius_nm]) if radius_nm[0] > 0.0 else radius_nm
        energy = energy[-(edges.size - 1) :] / (math.pi * np.diff(edges**2))
        # A ring's energy lies between its edges.
        radius_nm = 0.5 * (edges[1:] + edges[:-1])
    elif radius_nm[0] == 0.0 and radius_nm.size > 1:
        radius_nm[0] = 0.25 * radius_nm[1]  # A density on the axis holds for the innermost disc.
    return BeamPsf.fitted(radius_nm, energy, process.source)


def _table(path: Path) -> tuple[str, FloatArray]:
    """Header and the first two columns, shape (n, 2), of a text file."""
    expected = "a text file with a radius and an energy in each row"
    try:
        require_modest_table(path)
        lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    except OSError as error:
        raise InputError.single(str(path), "table_file", expected, f"{error}") from error
    header: list[str] = []
    rows: list[list[float]] = []
    for number, line in enumerate(lines, start=1):
        words = re.split(r"[,;\s]+", line.strip(" \t,;"))
        try:
            rows.append([float(word) for word in words[:2]])
        except ValueError:
            if rows and line.strip():
                raise InputError.single(str(path), f"line {number}", "two numbers", repr(line[:40])) from None
            header.append(line)
        if rows and len(rows[-1]) < 2:
            raise InputError.single(str(path), f"line {number}", "two numbers", repr(line[:40]))
    if not rows:
        raise InputError.single(str(path), "table_file", expected, "no row of numbers")
    return " ".join(header), np.array(rows, dtype=np.float64)


def _unit_of(header: str) -> Literal["nm", "um"] | None:
    """Unit of the radius by the first unit that the header names."""
    found = re.search(r"(?<![a-zA-Z])(nm|um|\u00b5m|\u03bcm|microns?|micrometers?)(?![a-zA-Z])", header, re.IGNORECASE)
    if found is None:
        return None
    return "nm" if found.group(1).lower() == "nm" else "um"


def exposure_process(design: Design, further: Sequence[Fault] = ()) -> ExposureProcess:
    """Return ``[process.exposure]`` of a design whose pillars the exposure can predict.

    InputError if there is no such table, with the keys that are not available with the exposure, and with the
    ``further`` faults that the caller found.
    """
    process = None if design.process is None else design.process.exposure
    if process is None:
        remedy = 'add `[process.exposure]` with `preset = "hsq_sos_100kv"`, or with your own `terms`'
        raise InputError.single(design.name, "process.exposure", "a table", "none", remedy)
    if faults := [*unavailable_keys(design), *further]:
        raise InputError(design.name, faults)
    return process


def unavailable_keys(design: Design) -> list[Fault]:
    """Keys of a design for which the exposure cannot predict its pillars; empty if it can."""
    faults, shape = [], design.unit_cell.cell.shape
    if shape in {"cross", "ring"}:
        expected = "'rectangle', 'circle' or 'ellipse'"
        faults.append(Fault("cell.shape", expected, repr(shape), "not available with the exposure"))
    if design.mask.tone != "negative":
        expected = "'negative', where the drawn pillars are exposed"
        faults.append(Fault("mask.tone", expected, repr(design.mask.tone), "not available with the exposure"))
    return faults
