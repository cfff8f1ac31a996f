"""Other propagation libraries: from the field behind a lens to one window of the sensor, each by its best method.

The program runs in an interpreter that has the peers (``benchmarks/optics/psf_peers.txt``), without metafab. It reads
one JSON object from stdin, ``{"method": name, "lenses": [...], "longest_s": s, "most_mb": mb}``. A lens has the keys of
:class:`Lens`, with a .npy file as ``field``. It writes one JSON line per lens: ``{"aperture_um": d, "seconds": s,
"carrier_s": s, "peak_rss_mb": mb, "irradiance": [[...]]}``. Lenses ascend in size until the next is expected to exceed
``longest_s`` seconds of processor time or ``most_mb`` of memory. The last line is then the expected cost of the largest
lens, scaled by N log N and N for the N points of the peer's grid: ``{"expected_um": d, "seconds": s, "peak_rss_mb":
mb}``.

The field on the lattice of the lens is given at no cost. There are two kinds of methods:

- *exact*: the angular spectrum or the Rayleigh-Sommerfeld integral by Fourier transforms. The output window is moved if
  the library can do so; else the grid holds lens and window. On periodic grids, light is read where it wraps around,
  which allows the smallest possible grid.
- *carrier*: one matrix Fourier transform or chirp z transform. The exact path to the middle of the window is removed
  beforehand at no cost (no library does that), and the window is stretched by the grating law. The path beyond the
  linear term is the error, which finer sampling does not reduce.

Imports, reusable transfer functions and a warm-up are not timed. Double precision where possible, one thread.
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
    """Field behind a lens, and a window on the sensor whose points are ``stride`` sites of the lattice apart."""

    aperture_um: float  #: Diameter.
    field: Any  #: Shape (n, n), complex field behind the lens; n is even, and the axis is in the middle.
    pitch_um: float  #: Distance of sites.
    wavelength_um: float  #: Vacuum wavelength.
    distance_um: float  #: Distance of the sensor.
    first: tuple[int, int]  #: (row, column) of the first point of the window, in sites from the first site of the lens.
    window_px: int  #: Points along a side.
    stride: int  #: Sites between points.

    @property
    def wavenumber(self) -> float:
        """Wavenumber, rad/um."""
        return 2.0 * math.pi / self.wavelength_um

    @property
    def sites_um(self) -> Any:
        """Positions of the sites along either axis."""
        count = self.field.shape[0]
        return (np.arange(count) - 0.5 * (count - 1)) * self.pitch_um

    @property
    def reach_sites(self) -> int:
        """Number of sites from the first to the last point of the window."""
        return (self.window_px - 1) * self.stride + 1

    @property
    def middle_um(self) -> tuple[float, float]:
        """(x, y) of point ``window_px // 2``."""
        row, column = (first + self.stride * (self.window_px // 2) for first in self.first)
        return self.sites_um[0] + column * self.pitch_um, self.sites_um[0] + row * self.pitch_um

    @property
    def pixel_um(self) -> float:
        """Distance of the points of the window."""
        return self.stride * self.pitch_um

    def padded(self, count: int) -> Any:
        """Return the field in the first rows and columns of a dark grid of shape (count, count)."""
        grid = np.zeros((count, count), dtype=np.complex128)
        grid[: self.field.shape[0], : self.field.shape[1]] = self.field
        return grid

    def read(self, grid: Any) -> Any:
        """Return the points of the window from a periodic grid that begins with the first site of the lens."""
        rows, columns = (
            (first + self.stride * np.arange(self.window_px)) % size
            for first, size in zip(self.first, grid.shape, strict=True)
        )
        return grid[np.ix_(rows, columns)]

    @property
    def carried(self) -> Any:
        """Field without the exact path to the middle of the window, and with the decay by distance."""
        x, y = self.sites_um[None, :] - self.middle_um[0], self.sites_um[:, None] - self.middle_um[1]
        path = np.sqrt(x * x + y * y + self.distance_um**2)
        return self.field * np.exp(1j * self.wavenumber * path) / path**2

    @property
    def focal_um(self) -> float:
        """Distance to the middle of the window: the focal length of the linear term of the path."""
        return math.hypot(*self.middle_um, self.distance_um)


#: Prepares reusable data and returns the propagation, whose result is the field on the window.
Prepare = Callable[[Lens], Callable[[], Any]]


def with_window(lens: Lens) -> int:
    """Points along a side of a grid for the convolution of the lens with the kernel on a moved window."""
    return lens.field.shape[0] + lens.reach_sites + 1


def about_axis(lens: Lens) -> int:
    """Points along a side of a grid about the axis that contains the window."""
    side = lens.field.shape[0]
    return int(side + 2 * max(0, *(max(-first, first + lens.reach_sites - side) for first in lens.first)))


def of_either(lens: Lens) -> int:
    """Points along a side of the larger of lens and window, an even number."""
    return max(lens.field.shape[0], lens.reach_sites + lens.reach_sites % 2)


def prysm_spectrum(lens: Lens) -> Callable[[], Any]:
    """angular_spectrum of prysm with an exact transfer function, as its own is that of Fresnel."""
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
    """AngularSpectrumPropagator of HCIPy, on a grid about the axis that contains lens and window."""
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
    """FraunhoferPropagator of HCIPy, which chooses a matrix Fourier transform for a small window."""
    import hcipy

    side, n = lens.field.shape[0], lens.window_px
    grid = hcipy.make_uniform_grid([side, side], np.array([side, side]) * lens.pitch_um * 1e-6)
    pixel = lens.pixel_um * 1e-6
    window = hcipy.CartesianGrid(hcipy.RegularCoords(np.full(2, pixel), np.full(2, n), np.full(2, -(n // 2) * pixel)))
    propagator = hcipy.FraunhoferPropagator(grid, window, lens.focal_um * 1e-6)
    front = hcipy.Wavefront(hcipy.Field(lens.carried.ravel(), grid), lens.wavelength_um * 1e-6)
    return lambda: np.asarray(propagator(front).electric_field).reshape(n, n)


def poppy_carrier(lens: Lens) -> Callable[[], Any]:
    """matrix_dft of poppy, inverse for the opposite sign; half a pixel of offset centres a point."""
    from poppy.matrixDFT import matrix_dft

    span = lens.window_px * lens.pixel_um * lens.field.shape[0] * lens.pitch_um / (lens.wavelength_um * lens.focal_um)
    carried = lens.carried

    def run() -> Any:
        return matrix_dft(carried, span, lens.window_px, offset=(0.5, 0.5), centering="ADJUSTABLE", inverse=True)

    return run


def torchoptics_integral(lens: Lens) -> Callable[[], Any]:
    """Field.propagate of torchoptics by direct integration (a Fourier convolution) to a moved plane."""
    import torch
    from torchoptics import Field

    torch.set_num_threads(1)
    metre, reach = 1e-6, lens.reach_sites
    # The axes are exchanged, to which the propagation is symmetric.
    data = torch.tensor(lens.field.astype(np.complex128))
    offset = [
        (first + 0.5 * (reach - 1) - 0.5 * (lens.field.shape[0] - 1)) * lens.pitch_um * metre for first in lens.first
    ]
    double = {"dtype": torch.double}

    def run() -> Any:
        light = Field(
            data,
            torch.tensor(lens.wavelength_um * metre, **double),
            torch.tensor(0.0, **double),
            spacing=torch.tensor(lens.pitch_um * metre, **double),
        )
        there = light.propagate(
            (reach, reach),
            torch.tensor(lens.distance_um * metre, **double),
            spacing=torch.tensor(lens.pitch_um * metre, **double),
            offset=torch.tensor(offset, **double),
            propagation_method="DIM",
            interpolation_mode="none",
        )
        return there.data.numpy()[:: lens.stride, :: lens.stride]

    return run


def diffractio_integral(lens: Lens) -> Callable[[], Any]:
    """RS of diffractio: the Rayleigh-Sommerfeld convolution to a moved grid of the size of the lens."""
    from diffractio.scalar_masks_XY import Scalar_mask_XY

    side, count = lens.field.shape[0], of_either(lens)
    # The grid must lie about the axis, as the parameter of the output position assumes.
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
    """CZT of diffractio, which removes the path to the axis itself; the field is multiplied by it beforehand."""
    from diffractio.scalar_masks_XY import Scalar_mask_XY

    axis = lens.sites_um
    square = axis[None, :] ** 2 + axis[:, None] ** 2 + lens.focal_um**2
    mask = Scalar_mask_XY(axis, axis, lens.wavelength_um)
    mask.u = lens.carried * np.exp(-1j * lens.wavenumber * np.sqrt(square)) * square
    # Measured: its points are n steps of 1/n of the requested span, shifted by one and a half steps.
    n = lens.window_px
    window = (-1.5 - n // 2 + np.arange(n) * (n / (n - 1))) * lens.pixel_um
    return lambda: mask.CZT(lens.focal_um, window, window).u


def dflat_spectrum(lens: Lens) -> Callable[[], Any]:
    """ASMPropagation of DFlat (single precision), on a grid about the axis, without extra padding."""
    import torch
    from dflat.propagation.propagators import ASMPropagation

    torch.set_num_threads(1)
    # Only odd sizes are accepted.
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
            whole = propagator(amplitude, phase)[0]
        return whole.numpy()[0, 0][np.ix_(rows, columns)]

    return run


@dataclass(frozen=True)
class Method:
    """A peer's method."""

    prepare: Prepare  #: Makes the propagation of a lens.
    points: Callable[[Lens], int]  #: Number of points of its largest grid.


METHODS = {
    "prysm, angular spectrum": Method(prysm_spectrum, lambda lens: with_window(lens) ** 2),
    "prysm, carrier": Method(prysm_carrier, lambda lens: lens.field.size),
    "hcipy, angular spectrum": Method(hcipy_spectrum, lambda lens: 4 * about_axis(lens) ** 2),
    "hcipy, carrier": Method(hcipy_carrier, lambda lens: lens.field.size),
    "poppy, carrier": Method(poppy_carrier, lambda lens: lens.field.size),
    "torchoptics, direct integration": Method(torchoptics_integral, lambda lens: with_window(lens) ** 2),
    "diffractio, Rayleigh-Sommerfeld": Method(diffractio_integral, lambda lens: 4 * of_either(lens) ** 2),
    "diffractio, carrier": Method(diffractio_carrier, lambda lens: lens.field.size),
    "dflat, angular spectrum": Method(dflat_spectrum, lambda lens: about_axis(lens) ** 2),
}


def main() -> None:
    """Run the job on stdin."""
    job = json.load(sys.stdin)
    method = METHODS[job["method"]]
    lenses = [Lens(**{**keys, "field": np.load(keys["field"], mmap_mode="r")}) for keys in job["lenses"]]
    cost = expected = Cost(0.0, 0.0)
    for lens, following in zip(lenses, (*lenses[1:], None), strict=True):
        cost = _measure(method, lens)
        if following is None:
            return
        expected = cost.scaled(method.points(lens), method.points(following))
        if expected.seconds > job["longest_s"] or expected.peak_rss_mb > job["most_mb"]:
            break
    last = cost.scaled(method.points(lens), method.points(lenses[-1]))
    print(json.dumps({"expected_um": lenses[-1].aperture_um, **asdict(last)}), flush=True)


@dataclass(frozen=True)
class Cost:
    """Cost of one window."""

    seconds: float  #: Processor time.
    peak_rss_mb: float  #: Peak memory of the program.

    def scaled(self, points: int, to_points: int) -> Cost:
        """Scale to a grid of another size by N log N and N."""
        ratio = to_points / points
        return Cost(self.seconds * ratio * math.log(to_points) / math.log(points), self.peak_rss_mb * ratio)


def _measure(method: Method, lens: Lens) -> Cost:
    start = time.process_time()
    _ = lens.carried
    carrier_s = time.process_time() - start
    run = method.prepare(lens)
    seconds: list[float] = []
    # The first run may compile or plan; one run is enough if it is long.
    while len(seconds) < 3 and sum(seconds) < 2.0:
        start = time.process_time()
        field = run()
        seconds.append(time.process_time() - start)
    cost = Cost(min(seconds), _peak_mb())
    line = {
        "aperture_um": lens.aperture_um,
        **asdict(cost),
        "carrier_s": carrier_s,
        "irradiance": (np.abs(field) ** 2).tolist(),
    }
    print(json.dumps(line), flush=True)
    return cost


def _peak_mb() -> float:
    """Peak resident memory of the program; `getrusage` may include its parent."""
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        return next(float(line.split()[1]) for line in status if line.startswith("VmHWM")) * 1024 / 1e6
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6


if __name__ == "__main__":
    main()
