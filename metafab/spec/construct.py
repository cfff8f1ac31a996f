"""Unit cells and designs made in Python, without any file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from metafab.core.arguments import is_several, require_types
from metafab.core.conventions import Side
from metafab.spec.cell import UnitCell
from metafab.spec.design import Design
from metafab.spec.new import write_field_um
from metafab.spec.toml import validate

if TYPE_CHECKING:
    from metafab.spec.scene import Scene
    from metafab.spec.terms import PhaseTerm


def make_unit_cell(
    *,
    period_nm: float | tuple[float, float],
    height_nm: float,
    pillar: complex | str,
    substrate: complex | str,
    wavelength_nm: float,
    sizes_nm: tuple[float, float],
    size_grid_nm: float = 2.0,
    ambient: complex | str = 1.0,
    side: Side = "substrate",
    shape: Literal["rectangle", "ellipse", "circle", "cross", "ring"] = "rectangle",
    lattice: Literal["rectangular", "hexagonal"] = "rectangular",
    wall_nm: float | None = None,
    inner_diameter_nm: float | None = None,
    target_error: float = 2e-3,
) -> UnitCell:
    """Make a unit cell; InputError with all faults.

    The other keys of a unit-cell file, such as films, sloped walls or further axes, keep their defaults until
    :func:`dataclasses.replace` sets them: ``replace(cell, cell=replace(cell.cell, sidewall_angle_deg=88.0))``.

    ``period_nm`` is one number or (x, y); ``pillar``, ``substrate`` and ``ambient`` are refractive indices n + ik, or
    names of material records. ``sizes_nm`` are the smallest and largest width and length of a pillar, ``size_grid_nm``
    their step. A ring has ``wall_nm``, the thickness of its wall, or ``inner_diameter_nm``. ``side`` is where the light
    comes from; ``target_error`` is the largest error of complex t in a library.
    """
    hole = {"wall_nm": wall_nm, "inner_diameter_nm": inner_diameter_nm}
    table = {
        "cell": {"period_nm": period_nm, "height_nm": height_nm, "shape": shape, "lattice": lattice}
        | {name: value for name, value in hole.items() if value is not None},
        "materials": {"pillar": _material(pillar), "substrate": _material(substrate), "ambient": _material(ambient)},
        "illumination": {"wavelength_nm": wavelength_nm, "side": side},
        "sweep": {
            "width_nm": sizes_nm,
            "length_nm": sizes_nm,
            "size_grid_nm": size_grid_nm,
            "target_error": target_error,
        },
    }
    return validate(UnitCell, _as_floats(table), "unit_cell")


def make_design(
    cell: UnitCell,
    *,
    aperture_um: float,
    focal_length_mm: float,
    phase: Sequence[PhaseTerm],
    pixel_um: float,
    focus_depth_m: float,
    depths_m: Sequence[float] | None = None,
    scene: Scene | None = None,
    name: str = "lens",
    aperture_shape: Literal["circle", "square"] = "circle",
    min_gap_nm: float = 100.0,
    min_feature_nm: float = 100.0,
    formats: Sequence[Literal["gds", "oas"]] = ("oas",),
    window_px: int = 64,
    target_error: float = 1e-3,
) -> Design:
    """Make a design; InputError with all faults.

    The other keys of a design file keep their defaults until :func:`dataclasses.replace` sets them:
    ``replace(design, rules=replace(design.rules, gap_rule="pairs"))``.

    Args:
        aperture_um: diameter, or side of a square.
        phase: terms of :mod:`metafab.spec.terms`, added up in order.
        focus_depth_m: object depth for which the sensor is in focus.
        depths_m: depths at which PSFs are simulated, ascending; ``focus_depth_m`` alone by default.
        name: name of the design and of the top cell of its mask.
        min_gap_nm: smallest gap between pillars.
        min_feature_nm: smallest width or length.
        formats: formats of the mask; none for a lens simulated from its target phases.
        target_error: relative error of the PSFs.
    """
    require_types("design", cell=(cell, UnitCell))
    table = {
        "name": name,
        "library": Path("library.h5"),
        "unit_cell": cell,
        "device": {"aperture_um": aperture_um, "focal_length_mm": focal_length_mm, "aperture_shape": aperture_shape},
        "phase": _as_tuple(phase),
        "rules": {"min_gap_nm": min_gap_nm, "min_feature_nm": min_feature_nm},
        "mask": {"formats": _as_tuple(formats), "write_field_um": write_field_um(cell)},
        "sensor": {"pixel_um": pixel_um, "focus_depth_m": focus_depth_m},
        "verify": {
            "depths_m": (focus_depth_m,) if depths_m is None else _as_tuple(depths_m),
            "window_px": window_px,
            "target_error": target_error,
        },
        "scene": scene,
    }
    return validate(Design, _as_floats(table), "design")


def _material(value: complex | str) -> str | dict[str, float]:
    """Table of an index, or the name of a record; anything else as it is, for :func:`validate` to refuse."""
    try:
        return value if isinstance(value, str) else {"n": complex(value).real, "k": complex(value).imag}
    except TypeError:
        return value  # type: ignore[return-value]


def _as_tuple(values: Any) -> Any:
    """Tuple of several values; a text, a table or a single value as it is, for :func:`validate` to refuse."""
    return tuple(values) if is_several(values) else values


#: Keys whose values are integers.
_INTEGERS = {"window_px"}


def _as_floats(value: Any, key: str = "") -> Any:
    """Copy of a table with whole numbers as floats: in Python, 350 nm is as good as 350.0 nm."""
    if isinstance(value, dict):
        return {name: _as_floats(item, name) for name, item in value.items()}
    if isinstance(value, tuple | list):
        return tuple(_as_floats(item, key) for item in value)
    if isinstance(value, np.integer):
        value = int(value)
    if isinstance(value, int) and not isinstance(value, bool) and key not in _INTEGERS:
        return float(value)
    return value
