"""Writing of a mask by the e-beam: fracture into trapezoids and shots, time, and order of the write fields.

Machines write trapezoids with two horizontal sides. A polygon is cut at the height of each of its corners; a rectangle
is one trapezoid. A Gaussian beam fills a trapezoid with shots at even distances; a shaped beam covers it with one shot,
or several where it is larger than the largest shot.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.figures import WriteTime
from metafab.spec import Exposure

BoolArray = NDArray[np.bool_]
IntegerArray = NDArray[np.int64]

#: Sides that are compared with strips at once.
_CROSSINGS = 1 << 22


@dataclass(frozen=True)
class LensLoad:
    """Load of one lens on the machine."""

    dose: float  #: Relative to the base dose.
    area_um2: float  #: Exposed area.
    trapezoids: int  #: Number of trapezoids.
    shots: int | None  #: Number of shots; None if it is not known.


def write_time(
    exposure: Exposure,
    lenses: Sequence[LensLoad],
    shapes: int,
    fields: int,
    stitching_nm: tuple[float, float] | None = None,
) -> WriteTime:
    """Estimate the time from dose, current and settling times.

    Dose classes within a lens count with the dose of the lens.

    Args:
        lenses: area, dose, trapezoids and shots of each lens.
        shapes: exposed shapes of all lenses.
        fields: write fields of all lenses that hold any.
        stitching_nm: rms and largest drift between neighbouring fields.
    """
    trapezoids = sum(lens.trapezoids for lens in lenses)
    shots = [lens.shots for lens in lenses if lens.shots is not None]
    beam_s = sum(
        float(beam_seconds(exposure, lens.dose, np.array(lens.area_um2), np.array(float(lens.shots or 0))))
        for lens in lenses
    )
    settling_s = trapezoids * exposure.settle_shape_us * 1e-6 + fields * exposure.settle_field_ms * 1e-3
    return WriteTime(
        area_um2=sum(lens.area_um2 for lens in lenses),
        shapes=shapes,
        trapezoids=trapezoids,
        shots=sum(shots) if len(shots) == len(lenses) else None,
        fields=fields,
        beam_seconds=beam_s,
        settling_seconds=settling_s,
        seconds=beam_s + settling_s,
        stitching_rms_nm=None if stitching_nm is None else stitching_nm[0],
        stitching_max_nm=None if stitching_nm is None else stitching_nm[1],
    )


def beam_seconds(exposure: Exposure, dose: float, area_um2: FloatArray, shots: FloatArray) -> FloatArray:
    """Time of the beam for areas and shots of equal shape: the charge over the current, or the shots over their rate.

    The dose is relative to the base dose; shots are 0 where they are not known.
    """
    # 1 uC/cm2 is 1e-8 uC/um2; nA are 1e-3 uC/s.
    charge_s = exposure.dose_uc_per_cm2 * dose * area_um2 * 1e-8 / (exposure.beam_current_na * 1e-3)
    if exposure.clock_mhz is None:
        return np.asarray(charge_s)
    return np.maximum(charge_s, shots / (exposure.clock_mhz * 1e6))


def fracture(polygons: Sequence[NDArray[np.int64]], unit_nm: float, exposure: Exposure) -> IntegerArray:
    """Cut polygons, corners of shape (n, 2) in database units for each size, into trapezoids and shots of the machine.

    A single point stands for no pillar. Returns the numbers of both, shape (2, n_sizes + 1); shots are 0 without a shot
    size.
    """
    cut = np.zeros((2, len(polygons)), dtype=np.int64)
    for number, polygon in enumerate(polygons):
        boxes = strips(polygon.astype(np.float64) * unit_nm, math.inf)
        width, height = (boxes[:, 2:] - boxes[:, :2]).T
        cut[0, number] = len(boxes)
        if exposure.max_shot_um is not None:
            largest_nm = exposure.max_shot_um * 1e3
            cut[1, number] = int((np.ceil(height / largest_nm) * np.ceil(width / largest_nm)).sum())
        elif exposure.shot_pitch_nm is not None:
            cut[1, number] = math.ceil(float((height * width).sum()) / exposure.shot_pitch_nm**2 - 1e-9)
    return cut


def strips(corners_nm: FloatArray, step_nm: float) -> FloatArray:
    """Rectangles (left, bottom, right, top), shape (m, 4), of the area of a polygon with corners of shape (n, 2).

    Strips along x end at every corner; where sides are inclined they are at most ``step_nm`` high, and as wide as in
    their middle. Shapes with holes are polygons with slits; parts that overlap an odd number of times count.
    """
    start, end = corners_nm, np.roll(corners_nm, -1, axis=0)
    levels = np.unique(corners_nm[:, 1])
    if math.isfinite(step_nm) and ((start != end).all(axis=1)).any():
        counts = np.maximum(1, np.ceil(np.diff(levels) / step_nm)).astype(int)
        ends = [
            np.linspace(low, high, n, endpoint=False) for low, high, n in zip(levels, levels[1:], counts, strict=False)
        ]
        levels = np.concatenate([*ends, levels[-1:]])
    rises = start[:, 1] != end[:, 1]
    (x, y), (next_x, next_y) = start[rises].T, end[rises].T
    found = [np.empty((0, 4))]
    for part in np.array_split(np.arange(levels.size - 1), 1 + levels.size * x.size // _CROSSINGS):
        middle = 0.5 * (levels[part] + levels[part + 1])[:, None]
        strip, side = np.nonzero((np.minimum(y, next_y) <= middle) & (np.maximum(y, next_y) > middle))
        place = x[side] + (next_x - x)[side] * (middle[strip, 0] - y[side]) / (next_y - y)[side]
        order = np.lexsort((place, strip))
        at, row = place[order].reshape(-1, 2), part[strip[order][::2]]
        found.append(np.stack([at[:, 0], levels[row], at[:, 1], levels[row + 1]], axis=1))
    return np.concatenate(found)


@dataclass(frozen=True, eq=False)
class FieldTimes:
    """Write fields in the order of writing, lens by lens."""

    lens: IntegerArray  #: Shape (n,), number of the lens of ``mask.copies``, from 1.
    place: IntegerArray  #: Shape (n, 2), row and column of the field in its lens.
    at_um: FloatArray  #: Shape (n, 2), x and y of the field's centre.
    start_s: FloatArray  #: Shape (n,), time at which it begins.
    seconds: FloatArray  #: Shape (n,), its duration.
    drift_nm: FloatArray  #: Shape (n,), drift at the middle of its time.
    stitching_nm: tuple[float, float]  #: Rms and largest difference of the drift of neighbouring fields of a lens.

    def table(self) -> list[str]:
        """Lines of ``fields.csv``."""
        lines = ["lens,row,column,x_um,y_um,start_s,seconds,drift_nm"]
        columns = (self.lens, *self.place.T, *self.at_um.T, self.start_s, self.seconds, self.drift_nm)
        for lens, row, column, x, y, start, seconds, drift in zip(*(c.tolist() for c in columns), strict=True):
            lines.append(f"{lens},{row},{column},{x:.4f},{y:.4f},{start:.6f},{seconds:.6f},{drift:.4f}")
        return lines


def field_times(exposure: Exposure, lens_seconds: Sequence[FloatArray], centre_um: Sequence[FloatArray]) -> FieldTimes:
    """Order the write fields of all lenses and add up their times.

    ``lens_seconds`` is the time of each field of each lens, shape (rows, columns), 0 for a field without shapes;
    ``centre_um`` its centre (x, y), shape (rows, columns, 2).
    """
    rate = exposure.drift_nm_per_min / 60.0
    lens, place, at, seconds = [], [], [], []
    for number, (times, centres) in enumerate(zip(lens_seconds, centre_um, strict=True), start=1):
        order = field_order(times > 0.0, exposure.field_order)
        lens.append(np.full(len(order), number))
        place.append(order)
        at.append(centres[order[:, 0], order[:, 1]])
        seconds.append(times[order[:, 0], order[:, 1]])
    duration = np.concatenate(seconds)
    start = np.cumsum(duration) - duration
    drift = rate * (start + 0.5 * duration)
    numbers, places = np.concatenate(lens), np.concatenate(place)
    steps = [
        _steps(drift[numbers == number], places[numbers == number], times.shape)
        for number, times in enumerate(lens_seconds, start=1)
    ]
    step = np.concatenate(steps)
    stitching = (float(np.sqrt(np.mean(step**2))), float(step.max())) if step.size else (0.0, 0.0)
    return FieldTimes(numbers, places, np.concatenate(at), start, duration, drift, stitching)


def field_order(filled: BoolArray, order: str) -> IntegerArray:
    """Order the fields of one lens that hold shapes, ``filled`` of shape (rows, columns): row and column, shape (n, 2).

    The orders are those of ``mask.exposure.field_order``.
    """
    row, column = np.nonzero(filled)
    if order in {"rows", "serpentine"}:
        along = np.where((row % 2 == 1) & (order == "serpentine"), -column, column)
        return np.stack([row, column], axis=1)[np.lexsort((along, row))]
    away = np.stack([row - 0.5 * (filled.shape[0] - 1), column - 0.5 * (filled.shape[1] - 1)])
    ring, angle = np.abs(away).max(axis=0), np.arctan2(*away)
    outwards = np.stack([row, column], axis=1)[np.lexsort((angle, ring))]
    return outwards[::-1] if order == "inwards" else outwards


def _steps(drift_nm: FloatArray, place: IntegerArray, shape: tuple[int, ...]) -> FloatArray:
    """Magnitudes of the differences of the drift between fields that share a side, shape (n,)."""
    grid = np.full(shape, np.nan)
    grid[place[:, 0], place[:, 1]] = drift_nm
    steps = np.abs(np.concatenate([np.diff(grid, axis=0).ravel(), np.diff(grid, axis=1).ravel()]))
    return np.asarray(steps[np.isfinite(steps)])
