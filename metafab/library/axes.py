"""Corners: what a library covers beyond sizes (wavelength, height, walls, bias, index, angle), and the cells there.

A corner is a value for each asked axis. Two axes are special. A bias of the critical dimension only moves every
size, so it is no variable of the model but a margin of its sizes. The response is even in the angle of incidence, in
the x-z and y-z planes, so the model's variable is sin^2 of it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from metafab.cell import PillarCell, pillar_cell
from metafab.core.conventions import FloatArray
from metafab.core.errors import Fault, InputError
from metafab.library.fit.rational import Range, scaled
from metafab.spec import UnitCell

Corner = Mapping[str, float]

_ANGLES = {"angle_x_deg": 0.0, "angle_y_deg": 90.0}


@dataclass(frozen=True)
class CornerBox:
    """The axes of a library, and the box of sizes and axes that its corner model is fitted over.

    Attributes:
        spans: name -> (lowest, highest), of the axes that were asked for.
        nominal: name -> the unit cell's own value.
        width_nm: smallest and largest width that is met, bias included; likewise ``length_nm``.
        length_nm: see ``width_nm``.
    """

    spans: Mapping[str, Range]
    nominal: Corner
    width_nm: Range
    length_nm: Range

    @classmethod
    def of(cls, unit_cell: UnitCell) -> CornerBox | None:
        """The box that a unit cell asks for; None if its sweep has no axes."""
        spans = {} if unit_cell.sweep.axes is None else unit_cell.sweep.axes.asked
        if not spans:
            return None
        low, high = spans.get("cd_bias_nm", (0.0, 0.0))
        (narrow, wide), (short, long) = unit_cell.sweep.width_nm, unit_cell.sweep.length_nm
        nominal = {name: unit_cell.nominal(name) for name in spans}
        return cls(spans, nominal, (narrow + low, wide + high), (short + low, long + high))

    @property
    def variables(self) -> tuple[str, ...]:
        """The axes that the model depends on: all but the bias."""
        return tuple(name for name in self.spans if name != "cd_bias_nm")

    @property
    def exchanges(self) -> bool:
        """Whether no axis tells x from y."""
        return not _ANGLES.keys() & self.spans.keys()

    def whole(self, asked: Corner) -> dict[str, float]:
        """``asked`` with the nominal value of every axis that it does not name.

        Raises:
            InputError: an axis is none of the library's, or a value lies outside its span (nothing is extrapolated).
        """
        faults, corner = [], dict(self.nominal)
        for name, value in asked.items():
            if name not in self.spans:
                has = ", ".join(self.spans)
                faults.append(Fault(name, f"an axis of the library ({has})", "none of them", "add it to `sweep.axes`"))
                continue
            low, high = self.spans[name]
            corner[name] = abs(float(value)) if name in _ANGLES else float(value)
            if not low <= corner[name] <= high:
                faults.append(Fault(name, f"{low:g} to {high:g}", f"{value:g}", "widen the span in `sweep.axes`"))
        if faults:
            raise InputError("library", faults)
        return corner

    def variables_of(self, corner: Corner) -> FloatArray:
        """The model's variables of a whole corner, each in -1..1: shape (n_variables,)."""
        places = []
        for name in self.variables:
            value, low, high = (_straight(name, at) for at in (corner[name], *self.spans[name]))
            places.append((2.0 * value - (low + high)) / (high - low))
        return np.array(places)

    def corner(self, scaled: FloatArray) -> dict[str, float]:
        """The inverse of :meth:`variables_of`; the bias, which is in the sizes, is left out."""
        corner = {}
        for name, place in zip(self.variables, scaled.tolist(), strict=True):
            low, high = (_straight(name, at) for at in self.spans[name])
            value = low + 0.5 * (place + 1.0) * (high - low)
            corner[name] = _bent(name, value)
        return corner

    def places(self, width_nm: FloatArray, length_nm: FloatArray, axes: FloatArray) -> FloatArray:
        """Cells as points of a cube: shape (n,) sizes as made and (n, n_variables) axes -> (n, 2 + n_variables)."""
        sizes = scaled(width_nm, self.width_nm), scaled(length_nm, self.length_nm)
        return np.concatenate([np.stack(sizes, axis=-1), axes], axis=1)


def corner_unit_cell(unit_cell: UnitCell, corner: Corner) -> UnitCell:
    """The unit cell at a corner, as far as its spec can say it: wavelength and geometry; without axes of its own."""
    wavelength_nm = corner.get("wavelength_nm", unit_cell.illumination.wavelength_nm)
    light = replace(unit_cell.illumination, wavelength_nm=wavelength_nm)
    geometry = replace(
        unit_cell.cell,
        height_nm=corner.get("height_nm", unit_cell.cell.height_nm),
        sidewall_angle_deg=corner.get("sidewall_angle_deg", unit_cell.cell.sidewall_angle_deg),
        corner_radius_nm=corner.get("corner_radius_nm", unit_cell.cell.corner_radius_nm),
    )
    return replace(unit_cell, cell=geometry, illumination=light, sweep=replace(unit_cell.sweep, axes=None))


def corner_cell(unit_cell: UnitCell, width_nm: float, length_nm: float, corner: Corner) -> PillarCell:
    """The cell of one pillar at a corner; axes that the corner does not name are the unit cell's own.

    Raises:
        InputError: as :func:`metafab.cell.pillar_cell`.
    """
    bias = corner.get("cd_bias_nm", 0.0)
    angles = {azimuth: corner[name] for name, azimuth in _ANGLES.items() if name in corner}
    azimuth_deg, angle_deg = next(iter(angles.items()), (0.0, 0.0))
    cell = pillar_cell(
        corner_unit_cell(unit_cell, corner),
        width_nm + bias,
        length_nm + bias,
        angle_deg=abs(angle_deg),
        azimuth_deg=azimuth_deg,
    )
    return replace(cell, n_pillar=cell.n_pillar + corner.get("pillar_n_shift", 0.0))


def _straight(name: str, value: float) -> float:
    """The value in which the response is smooth: sin^2 of an angle, the area that rounding takes, any other itself."""
    if name == "corner_radius_nm":
        return value**2
    return math.sin(math.radians(value)) ** 2 if name in _ANGLES else value


def _bent(name: str, straight: float) -> float:
    """The inverse of :func:`_straight`."""
    if name == "corner_radius_nm":
        return math.sqrt(max(straight, 0.0))
    return math.degrees(math.asin(math.sqrt(max(straight, 0.0)))) if name in _ANGLES else straight
