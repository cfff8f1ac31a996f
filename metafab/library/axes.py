"""Corners: values of wavelength, height, wall angle, bias, index or angle of incidence; cells and models at them.

A corner is a value for each axis of the sweep. Two axes are special. A bias of the critical dimension changes width and
length equally: it widens the model's range of sizes and is no variable of the model. The response is even in the angle
of incidence, in the x-z and y-z planes: the variable of the model is sin^2 of the angle.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from metafab.cell import PillarCell, pillar_cell
from metafab.cell.validation import check
from metafab.core.conventions import FloatArray
from metafab.core.errors import Fault, InputError
from metafab.core.figures import CornerStatistics
from metafab.library.fit.certificate import NEIGHBOURS, disagreement_estimate, steepness
from metafab.library.fit.models import RankedModels
from metafab.library.fit.rational import Range, RationalModel, scaled
from metafab.spec import UnitCell

#: Values by name of the axis, such as ``{"wavelength_nm": 803.0}``.
Corner = Mapping[str, float]

_AZIMUTH_DEG = {"angle_x_deg": 0.0, "angle_y_deg": 90.0}


@dataclass(frozen=True)
class CornerBox:
    """The axes of a library, and the box of sizes and axes over which its corner model is fitted."""

    spans: Mapping[str, Range]  #: (lowest, highest) by name of the axis.
    nominal: Corner  #: Values of the unit cell itself.
    width_nm: Range  #: Smallest and largest width, bias included.
    length_nm: Range  #: Smallest and largest length, bias included.
    is_round: bool = False  #: Whether width and length are one size, the diameter.

    @classmethod
    def of(cls, unit_cell: UnitCell) -> CornerBox | None:
        """Return the box of a unit cell's sweep; None if the sweep has no axes."""
        spans = {} if unit_cell.sweep.axes is None else unit_cell.sweep.axes.spans
        if not spans:
            return None
        low, high = spans.get("cd_bias_nm", (0.0, 0.0))
        (narrow, wide), (short, long) = unit_cell.sweep.width_nm, unit_cell.sweep.length_nm
        nominal = {name: unit_cell.nominal(name) for name in spans}
        return cls(spans, nominal, (narrow + low, wide + high), (short + low, long + high), unit_cell.cell.is_round)

    @property
    def variables(self) -> tuple[str, ...]:
        """The axes that are variables of the model: all but the bias."""
        return tuple(name for name in self.spans if name != "cd_bias_nm")

    @property
    def dimensions(self) -> int:
        """Number of independent sizes and variables."""
        return (1 if self.is_round else 2) + len(self.variables)

    @property
    def keeps_xy_symmetry(self) -> bool:
        """Whether the response keeps its symmetry under exchange of x and y along all axes."""
        return not _AZIMUTH_DEG.keys() & self.spans.keys()

    def completed(self, corner: Corner) -> dict[str, float]:
        """Return ``corner`` with the nominal value of every axis that it does not name.

        An axis that the library lacks, or a value outside its span, raises InputError (nothing is extrapolated).
        """
        faults, completed = [], dict(self.nominal)
        for name, value in corner.items():
            if name not in self.spans:
                expected = f"an axis of the library ({', '.join(self.spans)})"
                faults.append(Fault(name, expected, "none of them", "add it to `sweep.axes`"))
                continue
            low, high = self.spans[name]
            completed[name] = abs(float(value)) if name in _AZIMUTH_DEG else float(value)
            if not low <= completed[name] <= high:
                faults.append(Fault(name, f"{low:g} to {high:g}", f"{value:g}", "widen the span in `sweep.axes`"))
        if faults:
            raise InputError("library", faults)
        return completed

    def to_variables(self, corner: Corner) -> FloatArray:
        """Return the model's variables of a completed corner, each in -1..1: shape (n_variables,)."""
        variables = []
        for name in self.variables:
            value, low, high = (_smooth(name, at) for at in (corner[name], *self.spans[name]))
            variables.append((2.0 * value - (low + high)) / (high - low))
        return np.array(variables)

    def from_variables(self, variables: FloatArray) -> dict[str, float]:
        """Return the corner without its bias: inverse of :meth:`to_variables`, from shape (n_variables,)."""
        corner = {}
        for name, variable in zip(self.variables, variables.tolist(), strict=True):
            low, high = (_smooth(name, at) for at in self.spans[name])
            corner[name] = _from_smooth(name, low + 0.5 * (variable + 1.0) * (high - low))
        return corner

    def points(self, width_nm: FloatArray, length_nm: FloatArray, axes: FloatArray) -> FloatArray:
        """Return n cells as points of the cube [-1, 1]^(2 + n_variables), shape (n, 2 + n_variables).

        Widths and lengths as made have the shape (n,), axes (n, n_variables), each in -1..1.
        """
        sizes = scaled(width_nm, self.width_nm), scaled(length_nm, self.length_nm)
        return np.concatenate([np.stack(sizes, axis=-1), axes], axis=1)


def corner_unit_cell(unit_cell: UnitCell, corner: Corner) -> UnitCell:
    """Return the unit cell with the wavelength and geometry of a corner, and without axes.

    Bias, index shift and angle have no key in a unit cell; :func:`corner_cell` applies them.
    """
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
    """Return the cell of one pillar at a corner; axes that the corner does not name keep the unit cell's values.

    Errors as :func:`metafab.cell.pillar_cell`.
    """
    bias = corner.get("cd_bias_nm", 0.0)
    cell = pillar_cell(corner_unit_cell(unit_cell, corner), width_nm + bias, length_nm + bias, **incidence(corner))
    if cell.shape == "ring":
        # The wall grows on both of its sides.
        cell = replace(cell, hole_nm=unit_cell.cell.hole_nm(width_nm) - bias)
        check(cell)
    return replace(cell, n_pillar=cell.n_pillar + corner.get("pillar_n_shift", 0.0))


def incidence(corner: Corner) -> dict[str, float]:
    """Return the polar angle and the azimuth of incidence at a corner, for :func:`metafab.cell.pillar_cell`."""
    angles = {azimuth: corner[name] for name, azimuth in _AZIMUTH_DEG.items() if name in corner}
    azimuth_deg, angle_deg = next(iter(angles.items()), (0.0, 0.0))
    return {"angle_deg": abs(angle_deg), "azimuth_deg": azimuth_deg}


def _smooth(name: str, value: float) -> float:
    """Variable in which the response is smooth: sin^2 of an angle, the square of a radius, else the value itself."""
    if name == "corner_radius_nm":
        return value**2
    return math.sin(math.radians(value)) ** 2 if name in _AZIMUTH_DEG else value


def _from_smooth(name: str, smooth: float) -> float:
    """Inverse of :func:`_smooth`."""
    if name == "corner_radius_nm":
        return math.sqrt(max(smooth, 0.0))
    return math.degrees(math.asin(math.sqrt(max(smooth, 0.0)))) if name in _AZIMUTH_DEG else smooth


@dataclass(frozen=True)
class Corners:
    """Models over sizes and axes, with the solved cells that bound their error."""

    models: RankedModels  #: The model that is used, and its rivals of other degrees.
    safety_factor: float  #: Ratio of held-out errors to the models' disagreement, at least 1.
    floor: float  #: Least estimate of the model's error: the rms held-out error.
    place: FloatArray  #: Shape (n, 2 + n_variables), the solved cells in the box of sizes and axes, each in -1..1.
    certificate: FloatArray  #: Shape (n,), the solver's error at each.
    statistics: CornerStatistics = CornerStatistics()  #: Figures of the sampling.

    def at(
        self, box: CornerBox, corner: Corner, width_nm: FloatArray, length_nm: FloatArray, exchange: bool
    ) -> tuple[RationalModel, FloatArray, FloatArray]:
        """Return the model of a corner's drawn sizes, and its error at and around each: shape (n_length, n_width).

        The grid of sizes has the axes ``width_nm``, shape (n_width,), and ``length_nm``. ``corner`` holds a value for
        every axis, as :meth:`CornerBox.completed` returns; ``exchange`` says whether t_xx(W, L) = t_yy(L, W) there.
        """
        bias_nm, axes = corner.get("cd_bias_nm", 0.0), box.to_variables(corner)
        models = self.models.at(axes, bias_nm)
        best = models.best

        def model_error(disagreement: FloatArray) -> FloatArray:
            estimate = disagreement_estimate(disagreement, exchange)
            return np.asarray(np.maximum(self.safety_factor * estimate, self.floor), dtype=np.float64)

        on_grid = model_error(models.disagreement(width_nm, length_nm))
        around = model_error(models.disagreement(width_nm, length_nm, around=True))
        certificate = self._certificate(box, width_nm + bias_nm, length_nm + bias_nm, axes)
        return best, certificate + on_grid, certificate * steepness(best, width_nm, length_nm) + around

    def _certificate(self, box: CornerBox, width_nm: FloatArray, length_nm: FloatArray, axes: FloatArray) -> FloatArray:
        """The solver's error at each size: the largest of the nearest solved cells, shape (n_length, n_width)."""
        width, length = np.meshgrid(width_nm, length_nm)
        points = box.points(width.ravel(), length.ravel(), np.tile(axes, (width.size, 1)))
        count = min(NEIGHBOURS, self.certificate.size)
        near = cKDTree(self.place).query(points, k=count)[1].reshape(*width.shape, count)
        return np.asarray(self.certificate[near].max(axis=-1), dtype=np.float64)
