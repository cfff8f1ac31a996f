"""A unit cell to start from: geometry by rules of thumb for a wavelength, a material and a shape.

- Period: 7 % below the widest that sends no light into orders of the substrate (wavelength / n), samples a lens of the
  given aperture twice per zone (wavelength / (2 NA)) and carries few guided modes (1.65 wavelengths / n of the pillar).
- Height: 1.85 turns of phase in the pillar's material over the wave beside it, so that sizes between the limits of the
  process cover a turn; 2.2 for shapes that fill less of the cell.
- Sizes: from a fifth of the period to the period less a gap of about a quarter of it. Rings have a hole of a fifth of
  the period, and walls from an eighth of it.
"""

from __future__ import annotations

import math

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
_WIDEST = 1.65
_MARGIN, _TURNS = 0.93, {"rectangle": 1.85, "cross": 2.2, "ellipse": 2.2, "circle": 2.2, "ring": 2.2}
#: Gap and smallest size over the period, and the largest of either that a rule needs, nm.
_GAP, _FEATURE, _LARGEST_RULE_NM = 0.28, 0.22, 100.0
#: Hole and thinnest wall of rings over the period.
_HOLE, _WALL = 0.2, 0.125
_ROUND_NM = 10.0
#: Fewest steps of the sweep; a cross of two arms has one phase, which 210 sizes resolve well.
_FEWEST_STEPS = {"rectangle": 40, "cross": 20, "ellipse": 40, "circle": 40, "ring": 40}
#: Target error: the corners of crosses converge slowly, 0.9 s of processor time for 1.7e-2 and 4.5 s for 9.6e-3 (TiO2,
#: 633 nm, arms of 250 and 120 nm).
_ERROR = {"rectangle": 2e-3, "cross": 2e-2, "ellipse": 2e-3, "circle": 2e-3, "ring": 2e-3}


def starting_cell(
    wavelength_nm: float,
    material: str,
    *,
    substrate: str = "SiO2",
    shape: str = "rectangle",
    numerical_aperture: float = 0.0,
) -> str:
    """Return the text of a commented unit-cell file.

    Args:
        material: of the pillars: a usual name (TiO2, Si, a-Si, SiN, SiO2, Al2O3) or a record.
        substrate: likewise.
        shape: cross-section of the pillars: "rectangle", "circle", "ellipse", "cross" or "ring".
        numerical_aperture: of a lens made of such cells, below 1; 0 for any.

    Raises:
        InputError: an unknown material or shape, a record without that wavelength, or pillars whose index is too low.
    """
    if shape not in _ERROR:
        raise InputError.single("new", "--shape", f"one of {', '.join(_ERROR)}", repr(shape), near(shape, _ERROR))
    pillar, ground = (
        _record(name, wavelength_nm, option) for name, option in ((material, "--material"), (substrate, "--substrate"))
    )
    n, n_substrate = (refractive_index(Material(record=name), wavelength_nm)[0].real for name in (pillar, ground))
    if n < n_substrate + 0.3:
        expected = f"a material with an index above that of the substrate, {n_substrate:.3g}, by 0.3 or more"
        raise InputError.single("new", "--material", expected, f"{pillar} with {n:.3g}")
    widest_nm = wavelength_nm / max(n_substrate, 2.0 * numerical_aperture, n / _WIDEST)
    period_nm = _ROUND_NM * math.floor(_MARGIN * widest_nm / _ROUND_NM)
    height_nm = _ROUND_NM * round(_TURNS[shape] * wavelength_nm / (n - 1.0) / _ROUND_NM)
    gap_nm, low_nm = (
        _ROUND_NM * max(1, round(min(share * period_nm, _LARGEST_RULE_NM) / _ROUND_NM)) for share in (_GAP, _FEATURE)
    )
    high_nm = period_nm - gap_nm
    hole = ""
    if shape == "ring":
        hole_nm, wall_nm = (_ROUND_NM * max(1, round(share * period_nm / _ROUND_NM)) for share in (_HOLE, _WALL))
        low_nm = hole_nm + 2.0 * wall_nm
        hole = f"\ninner_diameter_nm = {hole_nm:.1f}"
    span_nm, fewest = high_nm - low_nm, _FEWEST_STEPS[shape]
    step_nm = next(step for step in (10.0, 5.0, 2.0, 1.0) if span_nm / step >= fewest or step == 1.0)
    return f"""# Pillars of {pillar} on {ground} at {wavelength_nm:g} nm, by the rules of thumb of
# `metafab new`; change what your process says. Periods below {wavelength_nm / n_substrate:.0f} nm keep all light in the
# zero order of the substrate.
source = "indices: records {pillar} ({n:.4g}) and {ground} ({n_substrate:.4g})"

[cell]
period_nm = {period_nm:.1f}
height_nm = {height_nm:.1f}
shape = "{shape}"{hole}

[materials]
pillar = "{pillar}"
substrate = "{ground}"
ambient = {{ n = 1.0 }}

[illumination]
wavelength_nm = {wavelength_nm!r}
side = "substrate"

[sweep]
width_nm = [{low_nm:.1f}, {high_nm:.1f}]            # gaps of {gap_nm:g} nm remain between the largest
length_nm = [{low_nm:.1f}, {high_nm:.1f}]
size_grid_nm = {step_nm:.1f}
target_error = {_ERROR[shape]:g}           # of complex t

[solver]
name = "rcwa"
"""


def _record(name: str, wavelength_nm: float, option: str) -> str:
    """Record of a material at a wavelength."""
    known = {record.name: record.range_nm for record in records()}
    tried = [name] if name in known else _RECORDS.get(name.lower(), ())
    if not tried:
        expected = f"a material such as {', '.join(sorted(known))}, TiO2, Si, a-Si, SiN"
        remedy = near(name, {*known, "TiO2", "Si", "a-Si", "SiN"}) or "`docs/howto/new-material.md` adds others"
        raise InputError.single("new", option, expected, repr(name), remedy)
    for record in tried:
        low, high = known[record]
        if low <= wavelength_nm <= high:
            return record
    ranges = "; ".join(f"{record} from {known[record][0]:g} to {known[record][1]:g} nm" for record in tried)
    raise InputError.single("new", option, f"a record with {wavelength_nm:g} nm", ranges, "name another record")
