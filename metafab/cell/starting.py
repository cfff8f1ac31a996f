"""A unit cell to start from: period and sizes by rules of thumb, height by a search with the solver at a low order.

- Period: 7 % below the widest that sends no light into orders of the substrate (wavelength / n), samples a lens of the
  given aperture twice per zone (wavelength / (2 NA)) and carries few guided modes (1.65 wavelengths / n of the pillar).
- Sizes: from a fifth of the period to the period less a gap of about a quarter of it. Rings have a hole of a fifth of
  the period, and walls from an eighth of it.
- Height: 1.85 to 3 turns of phase in the pillar's material over the wave beside it; the lowest whose sizes put nearly
  as much light into the wanted order of a slow grating as those of the best.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np

from metafab.cell import curved
from metafab.cell.pillar import PillarCell, Shape
from metafab.cell.rcwa.jones import zero_order
from metafab.core.conventions import ComplexArray, FloatArray, covered_rad
from metafab.core.errors import InputError
from metafab.materials import records, refractive_index
from metafab.spec.cell import Material
from metafab.spec.keys.reference import near

#: Records by the usual name of a material, in the order in which they are tried.
_RECORDS = {
    "tio2": ("TiO2/Jolivet-amorphous", "TiO2/Devore-o"),
    "si": ("Si/Schinke", "Si/Salzberg"),
    "a-si": ("a-Si/Pierce",),
    "sin": ("Si3N4/Luke",),
    "si3n4": ("Si3N4/Luke",),
    "sio2": ("SiO2/Malitson",),
    "al2o3": ("Al2O3/Malitson",),
}
#: Most wavelengths in the pillar's material that a period spans, and the proposed over the widest period.
_WIDEST, _MARGIN = 1.65, 0.93
#: Least index of a pillar.
_LEAST_INDEX = 1.3
#: Shortest wavelength; a smaller number is one in um.
_SHORTEST_NM = 10.0
#: Largest number that is accepted as an index, and largest extinction of a substrate over its index, for light to pass
#: it.
_LARGEST_INDEX, _DIMMEST = 100.0, 0.1
#: Heights that are tried, in turns of phase; between them, at 2.2 turns, two modes of the larger pillars of titanium
#: dioxide or silicon cancel behind the pillars: 37 to 61 % of the crosses pass less than half of the light.
_TURNS = (1.85, 2.2, 2.6, 3.0)
#: Loss of efficiency, against the best height, up to which a lower height is preferred.
_NEARLY = 0.02
#: Cosines (RCWA) and polynomial order (rings) of the search; t is off by some 1e-2. 4 and 27 ms a cell on one core.
_COSINES, _ORDER = 6, 3
#: Sizes along each axis in the search, by the number of axes; and in the reach, which takes every size of one axis.
_SIZES, _SIZES_OF_TWO = {1: 20, 2: 10}, 20
#: Gap and smallest size over the period.
_GAP, _FEATURE = 0.28, 0.22
#: Largest gap or smallest size that is proposed as a rule: the larger of this length and this share of the wavelength.
_LARGEST_RULE_NM, _LARGEST_RULE = 100.0, 0.05
#: Hole and thinnest wall of rings over the period.
_HOLE, _WALL = 0.2, 0.125
_ROUND_NM = 10.0
#: Fewest steps of the sweep; a cross of two arms has one phase, which 210 sizes resolve well.
_FEWEST_STEPS = {"rectangle": 40, "cross": 20, "ellipse": 40, "circle": 40, "ring": 40}
#: Target error: the corners of crosses converge slowly, 0.9 s of processor time for 1.7e-2 and 4.5 s for 9.6e-3 (TiO2,
#: 633 nm, arms of 250 and 120 nm).
_ERROR = {"rectangle": 2e-3, "cross": 2e-2, "ellipse": 2e-3, "circle": 2e-3, "ring": 2e-3}


@dataclass(frozen=True)
class StartingCell:
    """Unit-cell file, with the phase coverage and efficiency of its sizes."""

    text: str  #: Commented unit-cell file (TOML).
    reach_rad: float  #: Covered part of the phase circle by the sizes that transmit half of the light or more.
    efficiency: float  #: Share of the light that the sizes put into the wanted order of a slow grating.


def starting_cell(
    wavelength_nm: float,
    material: str,
    *,
    substrate: str = "SiO2",
    shape: str = "rectangle",
    numerical_aperture: float = 0.0,
    folder: Path = Path(),
) -> StartingCell:
    """Return a commented unit-cell file, in one to five seconds of processor time.

    Args:
        material: of the pillars: a usual name (TiO2, Si, a-Si, SiN, SiO2, Al2O3), a record, the path of a CSV file
            (``wavelength_nm,n,k``), or an index such as "2.4" or "3.7+0.01j".
        substrate: likewise.
        shape: cross-section of the pillars: "rectangle", "circle", "ellipse", "cross" or "ring".
        numerical_aperture: of a lens made of such cells, below 1; 0 for any.
        folder: of the unit-cell file, for the paths in it.

    Raises:
        InputError: an unknown material or shape, an unusable CSV file, a record without that wavelength, pillars whose
            index is too low for air, a substrate that light does not pass, or a period too short for sizes.
    """
    if shape not in _ERROR:
        raise InputError.single("new", "--shape", f"one of {', '.join(_ERROR)}", repr(shape), near(shape, _ERROR))
    if not _SHORTEST_NM <= wavelength_nm < math.inf:
        expected = f"a wavelength of {_SHORTEST_NM:g} nm or more"
        raise InputError.single("new", "--wavelength-nm", expected, f"{wavelength_nm:g}", "the unit is nm")
    pillar, ground = (
        _Medium.of(name, wavelength_nm, option, folder)
        for name, option in ((material, "--material"), (substrate, "--substrate"))
    )
    _require_lens(pillar, ground, wavelength_nm)
    widest_nm = wavelength_nm / max(ground.n, 2.0 * numerical_aperture, pillar.n / _WIDEST)
    sizes = _Sizes.of(_ROUND_NM * math.floor(_MARGIN * widest_nm / _ROUND_NM), wavelength_nm, shape)
    cell = PillarCell(
        period_nm=(sizes.period_nm, sizes.period_nm),
        width_nm=sizes.low_nm,
        length_nm=sizes.low_nm,
        height_nm=0.0,
        n_pillar=pillar.index[0],
        n_substrate=ground.index,
        n_ambient=1.0 + 0.0j,
        wavelength_nm=wavelength_nm,
        shape=cast("Shape", "ellipse" if shape == "circle" else shape),
        hole_nm=sizes.hole_nm,
    )
    cell = replace(cell, height_nm=_least_height_nm(cell, sizes))
    most = sizes.steps + 1
    fields = _fields(cell, sizes.spread_nm(most if sizes.axes == 1 else min(most, _SIZES_OF_TWO)), sizes.axes)
    reach_rad, efficiency = covered_rad(np.angle(fields[np.abs(fields) ** 2 >= 0.5])), _efficiency(fields)
    return StartingCell(_text(cell, shape, sizes, pillar, ground, reach_rad, efficiency), reach_rad, efficiency)


@dataclass(frozen=True)
class _Medium:
    """A material at the wavelength."""

    name: str  # in a sentence
    toml: str  # its value in a unit-cell file
    index: tuple[complex, complex]  # along x and y

    @classmethod
    def of(cls, name: str, wavelength_nm: float, option: str, folder: Path) -> _Medium:
        """A material by name, file or index; InputError for an unknown one."""
        material, called, toml = _material(name, wavelength_nm, option, folder)
        return cls(called, toml, refractive_index(material, wavelength_nm))

    @property
    def n(self) -> float:
        """Real part of the index along x."""
        return self.index[0].real


def _require_lens(pillar: _Medium, ground: _Medium, wavelength_nm: float) -> None:
    """Refuse pillars that guide no light in air, and a substrate that light does not pass."""
    if pillar.n < _LEAST_INDEX:
        expected = f"a material that guides light in air, with an index of {_LEAST_INDEX:g} or more"
        raise InputError.single("new", "--material", expected, f"{pillar.n:.3g} at {wavelength_nm:g} nm")
    if ground.n < 1.0 or ground.index[0].imag > _DIMMEST * ground.n:
        expected = f"a substrate that light passes: n of 1 or more, k of at most {_DIMMEST:g} n"
        raise InputError.single("new", "--substrate", expected, f"{ground.index[0]:.3g} at {wavelength_nm:g} nm")


@dataclass(frozen=True)
class _Sizes:
    """Period, sizes and steps of the sweep, nm."""

    period_nm: float
    gap_nm: float  # between the largest pillars
    low_nm: float
    high_nm: float
    hole_nm: float  # of rings
    step_nm: float
    axes: int  # 2 where width and length differ

    @classmethod
    def of(cls, period_nm: float, wavelength_nm: float, shape: str) -> _Sizes:
        """Sizes by the rules of thumb; InputError if the period is too short for any."""
        largest_nm = max(_LARGEST_RULE_NM, _LARGEST_RULE * wavelength_nm)
        gap_nm, low_nm = (_rounded_nm(min(share * period_nm, largest_nm)) for share in (_GAP, _FEATURE))
        high_nm, hole_nm = period_nm - gap_nm, 0.0
        if shape == "ring":
            hole_nm, wall_nm = (_rounded_nm(share * period_nm) for share in (_HOLE, _WALL))
            low_nm = hole_nm + 2.0 * wall_nm
        if low_nm >= high_nm:
            expected = f"a wavelength and indices whose period holds sizes in steps of {_ROUND_NM:g} nm beside a gap"
            got = f"a period of {period_nm:g} nm"
            raise InputError.single("new", "--wavelength-nm, --material, --substrate", expected, got)
        longest_nm = (high_nm - low_nm) / _FEWEST_STEPS[shape]
        step_nm = next((step for step in (100.0, 50.0, 20.0, 10.0, 5.0, 2.0) if step <= longest_nm), 1.0)
        axes = 1 if shape in {"circle", "ring"} else 2
        return cls(period_nm, gap_nm, low_nm, high_nm, hole_nm, step_nm, axes)

    @property
    def steps(self) -> int:
        """Steps along each axis."""
        return round((self.high_nm - self.low_nm) / self.step_nm)

    def spread_nm(self, count: int) -> FloatArray:
        """``count`` even sizes from the smallest to the largest, shape (count,)."""
        return np.linspace(self.low_nm, self.high_nm, count)


def _rounded_nm(length_nm: float) -> float:
    """The nearest multiple of `_ROUND_NM`, at least one."""
    return _ROUND_NM * max(1, round(length_nm / _ROUND_NM))


def _least_height_nm(cell: PillarCell, sizes: _Sizes) -> float:
    """Least height whose sizes send nearly as much light into a grating's order as those of the best height."""
    n = cell.n_pillar.real
    heights_nm = [_ROUND_NM * round(turns * cell.wavelength_nm / (n - 1.0) / _ROUND_NM) for turns in _TURNS]
    few_nm = sizes.spread_nm(_SIZES[sizes.axes])
    shares = [_efficiency(_fields(replace(cell, height_nm=height_nm), few_nm, sizes.axes)) for height_nm in heights_nm]
    return next(h for h, share in zip(heights_nm, shares, strict=True) if share >= max(shares) - _NEARLY)


def _text(
    cell: PillarCell,
    shape: str,
    sizes: _Sizes,
    pillar: _Medium,
    ground: _Medium,
    reach_rad: float,
    efficiency: float,
) -> str:
    """The commented unit-cell file."""
    indices = f"indices: {pillar.name} ({pillar.n:.4g}) and {ground.name} ({ground.n:.4g})"
    hole = f"\ninner_diameter_nm = {sizes.hole_nm:.1f}" if shape == "ring" else ""
    widest_nm = cell.wavelength_nm / ground.n
    return f"""# Pillars of {pillar.name} on {ground.name} at {cell.wavelength_nm:g} nm, by the rules of thumb and the
# search of `metafab new`; change them to suit your process. Periods below {widest_nm:.0f} nm keep all
# light in the zero order of the substrate. Solved at a low order, the sizes that transmit half of the light or more
# reach {reach_rad:.2f} rad of phase (a turn is 6.28). A slow grating of these pillars sends {100.0 * efficiency:.0f} %
# of the light into its order.
source = {json.dumps(indices, ensure_ascii=False)}

[cell]
period_nm = {sizes.period_nm:.1f}
height_nm = {cell.height_nm:.1f}
shape = "{shape}"{hole}

[materials]
pillar = {pillar.toml}
substrate = {ground.toml}
ambient = {{ n = 1.0 }}

[illumination]
wavelength_nm = {cell.wavelength_nm!r}
side = "substrate"

[sweep]
width_nm = [{sizes.low_nm:.1f}, {sizes.high_nm:.1f}]            # gaps of {sizes.gap_nm:g} nm remain between the largest
length_nm = [{sizes.low_nm:.1f}, {sizes.high_nm:.1f}]
size_grid_nm = {sizes.step_nm:.1f}
target_error = {_ERROR[shape]:g}           # of complex t

[solver]
name = "rcwa"
"""


def _fields(cell: PillarCell, sizes_nm: FloatArray, axes: int) -> ComplexArray:
    """Power-normalised zero-order t of either polarisation, shape (n,), at ``sizes_nm`` along one or each of two axes.

    Of a size and its mirror image only one is solved: x light at one is y light at the other.
    """
    t: list[complex] = []
    for width_nm in sizes_nm.tolist():
        for length_nm in sizes_nm[sizes_nm <= width_nm].tolist() if axes == 2 else [width_nm]:
            one = replace(cell, width_nm=width_nm, length_nm=length_nm)
            solved = curved.zero_order(one, _ORDER) if cell.shape == "ring" else zero_order(one, _COSINES)
            t += np.diagonal(solved.t).tolist()
    return np.array(t, dtype=np.complex128) * math.sqrt(cell.n_out[0].real / cell.n_in[0].real)


def _efficiency(fields: ComplexArray) -> float:
    """Share of light in the order of a grating whose phases rise evenly, each by the field that overlaps it best."""
    target = np.exp(2j * np.pi * np.arange(256) / 256.0)
    best = np.argmax((fields * target.conj()[:, None]).real, axis=1)
    return float(np.abs(np.mean(fields[best] * target.conj())) ** 2)


def _material(name: str, wavelength_nm: float, option: str, folder: Path) -> tuple[Material, str, str]:
    """A material by name, file or index, its name in a sentence, and its value in a unit-cell file in ``folder``."""
    try:
        index = complex(name.lower().replace("i", "j"))
    except ValueError:
        pass
    else:
        if not (0.0 < index.real <= _LARGEST_INDEX and 0.0 <= index.imag <= _LARGEST_INDEX):
            expected = f"an index n + kj with n above 0 and k of 0 or more, at most {_LARGEST_INDEX:g}"
            raise InputError.single("new", option, expected, repr(name))
        return Material(n=index.real, k=index.imag), f"index {name}", f"{{ n = {index.real!r}, k = {index.imag!r} }}"
    if name.lower().endswith(".csv"):
        # Of real paths: `..` in a path through a linked folder starts where the link leads.
        inside = Path(os.path.relpath(os.path.realpath(name), os.path.realpath(folder))).as_posix()
        return Material(record=name), Path(name).name, json.dumps(inside, ensure_ascii=False)
    record = _record(name, wavelength_nm, option)
    return Material(record=record), record, f'"{record}"'


def _record(name: str, wavelength_nm: float, option: str) -> str:
    """Record of a material at a wavelength."""
    known = {record.name: record.range_nm for record in records()}
    tried = [name] if name in known else _RECORDS.get(name.lower(), ())
    if not tried:
        usual = ("TiO2", "Si", "a-Si", "SiN")
        named = ", ".join((*usual, *sorted(known)))
        expected = f"a material such as {named}; a CSV file (`wavelength_nm,n,k`) or an index such as 2.4+0.01j"
        raise InputError.single("new", option, expected, repr(name), near(name, {*known, *usual}))
    for record in tried:
        low, high = known[record]
        if low <= wavelength_nm <= high:
            return record
    ranges = " and ".join(f"{record} from {known[record][0]:g} to {known[record][1]:g} nm" for record in tried)
    remedy = "name another record, or a CSV file"
    raise InputError.single("new", option, f"a record that holds {wavelength_nm:g} nm", ranges, remedy)
