"""Other propagation libraries on our lens: the field behind it to one window of the sensor, each in its best way.

Run as a program by an interpreter that has the peers (``benchmarks/psf_peers.txt``); neither metafab nor its
packages need to be there. It reads one JSON object from stdin, ``{"way": name, "lenses": [...], "longest_s": s,
"most_mb": mb}``, where a lens has the keys of :class:`Lens` but ``field`` names a .npy file, and writes one JSON
line for each lens that it carried: ``{"aperture_um": d, "seconds": s, "carrier_s": s, "peak_rss_mb": mb,
"irradiance": [[...]]}``. Lenses rise in size until the next is expected to take more than ``longest_s`` seconds of
processor time or ``most_mb`` of memory. What the last of the lenses would take, in proportion to N log N and to N
for the N points of the peer's grid, ends the answer then: ``{"expected_um": d, "seconds": s, "peak_rss_mb": mb}``.

Each gets the field on the lens' lattice for nothing. Two kinds of way are taken:

- *exact*: the angular spectrum or the Rayleigh-Sommerfeld integral by Fourier transforms. Where a library can move the
  output window it is moved; where it cannot, the grid holds lens and window. Where grids are periodic, light is read
  where it wraps around, which allows the smallest grid there is.
- *carrier*: one matrix Fourier transform or chirp z transform. The exact path to the middle of the window is removed
  beforehand (for nothing: no library does that), and the window is stretched as the grating law wants it. What remains
  of the path beyond the linear term is their error, which no finer sampling lowers.

Imports, transfer functions that can be kept, and a warm-up are not counted. Double precision where there is a choice,
one thread.
"""

from __future__ import annotations

import json
import math
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Lens:
    """The lit lens, and the window on the sensor: points of the lens' lattice, ``stride`` sites apart.

    Attributes:
        aperture_um: diameter.
        field: [y, x], complex, behind the lens; even number of sites a side, the axis in the middle.
        pitch_um: of the sites.
        wavelength_um: in vacuum.
        distance_um: of the sensor.
        first: (row, column) of the window's first point, in sites from the lens' first.
        window_px: points a side.
        stride: sites between points.
    """

    aperture_um: float
    field: Any
    pitch_um: float
    wavelength_um: float
    distance_um: float
    first: tuple[int, int]
    window_px: int
    stride: int

    @property
    def wavenumber(self) -> float:
        """2 pi / wavelength."""
        return 2.0 * math.pi / self.wavelength_um

    @property
    def sites_um(self) -> Any:
        """Positions of the sites along either axis."""
        count = self.field.shape[0]
        return (np.arange(count) - 0.5 * (count - 1)) * self.pitch_um

    @property
    def reach_sites(self) -> int:
        """Sites of the window from its first to its last point."""
        return (self.window_px - 1) * self.stride + 1

    @property
    def middle_um(self) -> tuple[float, float]:
        """(x, y) of point ``window_px // 2``."""
        row, column = (first + self.stride * (self.window_px // 2) for first in self.first)
        return self.sites_um[0] + column * self.pitch_um, self.sites_um[0] + row * self.pitch_um

    @property
    def pixel_um(self) -> float:
        """Distance of the window's points."""
        return self.stride * self.pitch_um

    def padded(self, count: int) -> Any:
        """The field in a dark grid of ``count`` sites a side, its first site at the grid's first."""
        grid = np.zeros((count, count), dtype=np.complex128)
        grid[: self.field.shape[0], : self.field.shape[1]] = self.field
        return grid

    def read(self, grid: Any) -> Any:
        """The window's points of a periodic grid that begins with the lens' first site."""
        rows, columns = (
            (first + self.stride * np.arange(self.window_px)) % size
            for first, size in zip(self.first, grid.shape, strict=True)
        )
        return grid[np.ix_(rows, columns)]

    @property
    def carried(self) -> Any:
        """The field without the exact path to the window's middle, and with the fall-off there."""
        x, y = self.sites_um[None, :] - self.middle_um[0], self.sites_um[:, None] - self.middle_um[1]
        path = np.sqrt(x * x + y * y + self.distance_um**2)
        return self.field * np.exp(1j * self.wavenumber * path) / path**2

    @property
    def focal_um(self) -> float:
        """Distance to the window's middle: of the linear term of the path, across the plane of incidence."""
        return math.hypot(*self.middle_um, self.distance_um)


#: Makes ready what can be kept, and returns what carries the light: irradiance's square root on the window.
Prepare = Callable[[Lens], Callable[[], Any]]


def with_window(lens: Lens) -> int:
    """Points a side of a grid that holds lens and window end to end: of a Fourier convolution with a moved window."""
    return lens.field.shape[0] + lens.reach_sites + 1


def about_axis(lens: Lens) -> int:
    """Points a side of a grid about the axis in which the window lies."""
    side = lens.field.shape[0]
    return int(side + 2 * max(0, *(max(-first, first + lens.reach_sites - side) for first in lens.first)))


def of_either(lens: Lens) -> int:
    """Points a side of the larger of lens and window, an even number."""
    return max(lens.field.shape[0], lens.reach_sites + lens.reach_sites % 2)


def prysm_spectrum(lens: Lens) -> Callable[[], Any]:
    """angular_spectrum of prysm with the exact transfer function handed in: its own is that of Fresnel."""
    from prysm.propagation import angular_spectrum

    count = with_window(lens)
    square = (lens.wavelength_um * np.fft.fftfreq(count, lens.pitch_um)) ** 2
    cosine = np.sqrt(1.0 - square[:, None] - square[None, :] + 0j)
    transfer = np.exp(1j * lens.wavenumber * lens.distance_um * cosine)
    field = lens.padded(count)
    return lambda: lens.read(angular_spectrum(field, 0.0, 0.0, 0.0, tf=transfer))


def prysm_carrier(lens: Lens) -> Callable[[], Any]:
    """focus_fixed_sampling of prysm, by matrices."""
    from prysm.propagation import focus_fixed_sampling

    carried = lens.carried

    def run() -> Any:
        return focus_fixed_sampling(
            carried, lens.pitch_um * 1e-3, lens.focal_um * 1e-3, lens.wavelength_um, lens.pixel_um, lens.window_px
        )

    return run


def hcipy_spectrum(lens: Lens) -> Callable[[], Any]:
    """AngularSpectrumPropagator of HCIPy, on a grid about the axis that holds lens and window."""
    import hcipy

    side, count = lens.field.shape[0], about_axis(lens)
    margin = (count - side) // 2
    field = np.zeros((count, count), dtype=np.complex128)
    field[margin : margin + side, margin : margin + side] = lens.field
    grid = hcipy.make_uniform_grid([count, count], np.array([count, count]) * lens.pitch_um * 1e-6)
    propagator = hcipy.AngularSpectrumPropagator(grid, lens.distance_um * 1e-6, num_oversampling=1)
    front = hcipy.Wavefront(hcipy.Field(field.ravel(), grid), lens.wavelength_um * 1e-6)
    rows, columns = (margin + first + lens.stride * np.arange(lens.window_px) for first in lens.first)

    def run() -> Any:
        return np.asarray(propagator(front).electric_field).reshape(count, count)[np.ix_(rows, columns)]

    return run


def hcipy_carrier(lens: Lens) -> Callable[[], Any]:
    """FraunhoferPropagator of HCIPy, which takes a matrix Fourier transform for so few points."""
    import hcipy

    side, n = lens.field.shape[0], lens.window_px
    grid = hcipy.make_uniform_grid([side, side], np.array([side, side]) * lens.pitch_um * 1e-6)
    pixel = lens.pixel_um * 1e-6
    window = hcipy.CartesianGrid(hcipy.RegularCoords(np.full(2, pixel), np.full(2, n), np.full(2, -(n // 2) * pixel)))
    propagator = hcipy.FraunhoferPropagator(grid, window, lens.focal_um * 1e-6)
    front = hcipy.Wavefront(hcipy.Field(lens.carried.ravel(), grid), lens.wavelength_um * 1e-6)
    return lambda: np.asarray(propagator(front).electric_field).reshape(n, n)


def poppy_carrier(lens: Lens) -> Callable[[], Any]:
    """matrix_dft of poppy, whose sign is the other one; half a pixel of offset puts a point on the middle."""
    from poppy.matrixDFT import matrix_dft

    span = lens.window_px * lens.pixel_um * lens.field.shape[0] * lens.pitch_um / (lens.wavelength_um * lens.focal_um)
    carried = lens.carried

    def run() -> Any:
        return matrix_dft(carried, span, lens.window_px, offset=(0.5, 0.5), centering="ADJUSTABLE", inverse=True)

    return run


def torchoptics_integral(lens: Lens) -> Callable[[], Any]:
    """Field.propagate of torchoptics by direct integration (a Fourier convolution) to a plane that is moved aside."""
    import torch
    from torchoptics import Field

    torch.set_num_threads(1)
    metre, reach = 1e-6, lens.reach_sites
    # Its first axis is our second, but both are alike to it.
    data = torch.tensor(lens.field.astype(np.complex128))
    aside = [
        (first + 0.5 * (reach - 1) - 0.5 * (lens.field.shape[0] - 1)) * lens.pitch_um * metre for first in lens.first
    ]
    double = {"dtype": torch.double}

    def run() -> Any:
        light = Field(
            data, torch.tensor(lens.wavelength_um * metre, **double), torch.tensor(0.0, **double),
            spacing=torch.tensor(lens.pitch_um * metre, **double),
        )  # fmt: skip
        there = light.propagate(
            (reach, reach), torch.tensor(lens.distance_um * metre, **double),
            spacing=torch.tensor(lens.pitch_um * metre, **double), offset=torch.tensor(aside, **double),
            propagation_method="DIM", interpolation_mode="none",
        )  # fmt: skip
        return there.data.numpy()[:: lens.stride, :: lens.stride]

    return run


def diffractio_integral(lens: Lens) -> Callable[[], Any]:
    """RS of diffractio: the Rayleigh-Sommerfeld convolution to as many points as the lens has, moved aside."""
    from diffractio.scalar_masks_XY import Scalar_mask_XY

    side, count = lens.field.shape[0], of_either(lens)
    # About the axis: its parameter for the output's place takes that for granted.
    margin = (count - side) // 2
    axis = (np.arange(count) - 0.5 * (count - 1)) * lens.pitch_um
    mask = Scalar_mask_XY(axis, axis, lens.wavelength_um)
    mask.u = np.zeros((count, count), dtype=np.complex128)
    mask.u[margin : margin + side, margin : margin + side] = lens.field
    start_y, start_x = (axis[0] + (first + margin) * lens.pitch_um for first in lens.first)

    def run() -> Any:
        whole = mask.RS(z=lens.distance_um, xout=start_x, yout=start_y, matrix=True, verbose=False)
        return whole[: lens.reach_sites : lens.stride, : lens.reach_sites : lens.stride]

    return run


def diffractio_carrier(lens: Lens) -> Callable[[], Any]:
    """CZT of diffractio; the path that it removes itself, to the axis, is given back first."""
    from diffractio.scalar_masks_XY import Scalar_mask_XY

    axis = lens.sites_um
    square = axis[None, :] ** 2 + axis[:, None] ** 2 + lens.focal_um**2
    mask = Scalar_mask_XY(axis, axis, lens.wavelength_um)
    mask.u = lens.carried * np.exp(-1j * lens.wavenumber * np.sqrt(square)) * square
    # Its points are n intervals of a whole n-th of the span asked for, one and a half of them on (measured).
    n = lens.window_px
    window = (-1.5 - n // 2 + np.arange(n) * (n / (n - 1))) * lens.pixel_um
    return lambda: mask.CZT(lens.focal_um, window, window).u


def dflat_spectrum(lens: Lens) -> Callable[[], Any]:
    """ASMPropagation of DFlat, which works in single precision, on a grid about the axis, without its extra padding."""
    import torch
    from dflat.propagation.propagators import ASMPropagation

    torch.set_num_threads(1)
    # Odd numbers alone are taken.
    side = lens.field.shape[0] | 1
    field, count = lens.padded(side), about_axis(lens) + side - lens.field.shape[0]
    margin = (count - side) // 2
    step = [lens.pitch_um * 1e-6] * 2
    propagator = ASMPropagation(
        [side, side], step, lens.distance_um * 1e-6, [count, count], step, [lens.wavelength_um * 1e-6], FFTPadFactor=0.0
    )
    amplitude, phase = (torch.tensor(part(field)[None, None], dtype=torch.float32) for part in (np.abs, np.angle))
    rows, columns = (margin + first + lens.stride * np.arange(lens.window_px) for first in lens.first)

    def run() -> Any:
        with torch.no_grad():
            found = propagator(amplitude, phase)[0]
        return found.numpy()[0, 0][np.ix_(rows, columns)]

    return run


@dataclass(frozen=True)
class Way:
    """A peer's function, and how many points its largest grid has."""

    prepare: Prepare
    points: Callable[[Lens], int]


WAYS = {
    "prysm, angular spectrum": Way(prysm_spectrum, lambda lens: with_window(lens) ** 2),
    "prysm, carrier": Way(prysm_carrier, lambda lens: lens.field.size),
    "hcipy, angular spectrum": Way(hcipy_spectrum, lambda lens: 4 * about_axis(lens) ** 2),
    "hcipy, carrier": Way(hcipy_carrier, lambda lens: lens.field.size),
    "poppy, carrier": Way(poppy_carrier, lambda lens: lens.field.size),
    "torchoptics, direct integration": Way(torchoptics_integral, lambda lens: with_window(lens) ** 2),
    "diffractio, Rayleigh-Sommerfeld": Way(diffractio_integral, lambda lens: 4 * of_either(lens) ** 2),
    "diffractio, carrier": Way(diffractio_carrier, lambda lens: lens.field.size),
    "dflat, angular spectrum": Way(dflat_spectrum, lambda lens: about_axis(lens) ** 2),
}


def main() -> None:
    """Answer the job on stdin."""
    job = json.load(sys.stdin)
    way = WAYS[job["way"]]
    lenses = [Lens(**{**given, "field": np.load(given["field"], mmap_mode="r")}) for given in job["lenses"]]
    cost = expected = Cost(0.0, 0.0)
    for lens, following in zip(lenses, (*lenses[1:], None), strict=True):
        cost = _measure(way, lens)
        if following is None:
            return
        expected = cost.scaled(way.points(lens), way.points(following))
        if expected.seconds > job["longest_s"] or expected.peak_rss_mb > job["most_mb"]:
            break
    last = cost.scaled(way.points(lens), way.points(lenses[-1]))
    print(json.dumps({"expected_um": lenses[-1].aperture_um, **asdict(last)}), flush=True)


@dataclass(frozen=True)
class Cost:
    """Of one window."""

    seconds: float
    peak_rss_mb: float

    def scaled(self, points: int, to_points: int) -> Cost:
        """What a grid of another size takes by N log N and N."""
        ratio = to_points / points
        return Cost(self.seconds * ratio * math.log(to_points) / math.log(points), self.peak_rss_mb * ratio)


def _measure(way: Way, lens: Lens) -> Cost:
    start = time.process_time()
    _ = lens.carried
    carrier_s = time.process_time() - start
    run = way.prepare(lens)
    seconds: list[float] = []
    # The first may compile or plan; of a long one, one is enough.
    while len(seconds) < 3 and sum(seconds) < 2.0:
        start = time.process_time()
        found = run()
        seconds.append(time.process_time() - start)
    cost = Cost(min(seconds), _peak_mb())
    line = {
        "aperture_um": lens.aperture_um,
        **asdict(cost),
        "carrier_s": carrier_s,
        "irradiance": (np.abs(found) ** 2).tolist(),
    }
    print(json.dumps(line), flush=True)
    return cost


def _peak_mb() -> float:
    """Largest resident memory since the program began; what `getrusage` says may be its parent's."""
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        return next(float(line.split()[1]) for line in status if line.startswith("VmHWM")) * 1024 / 1e6
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6


if __name__ == "__main__":
    main()
