"""Focus of an NA 0.9 lens of 20 um: all of it by Meep, against the library's field and vectorial focusing.

Square silicon pillars on fused silica focus x polarised light of 1550 nm, 13 wavelengths wide. Meep solves the whole
lens in three dimensions, a quarter of it by its mirror planes. Its E_x and E_y where the pillars end, dark outside the
lens' sites, are propagated by the dyadic Rayleigh-Sommerfeld integral, with E_z, to the focal plane. Beside them:

- ``library and vectorial focusing``: what `metafab run` computes, from the zero-order t of each lone pillar
- ``lone pillars on Meep's grid``: the same from Meep's t of each lone pillar; the library's difference from it is the
  error of the grid, Meep's that of the neighbours
- ``Meep's E_x and vectorial focusing``: the same focusing of Meep's E_x at the sites, so that coupling drops out
- ``library and scalar focusing``: |E_x|^2 of a scalar wave
- ``ideal flat lens``: integral of Richards and Wolf's kind over the aperture

``error`` is the relative L2 difference of |E|^2 from Meep's within 3 wavelengths of the axis, each over its maximum;
widths are full widths at half maximum of |E|^2. ``seconds`` is the processor time of Meep; in each other row, that of
all other work together. ``peak_rss_mb`` is that of Meep. About four minutes in all; ``--quick`` is a lens of 6 um.
``--sites N`` and ``--pixels N`` are another lens and another grid.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import RectBivariateSpline

from benchmarks.optics.direct_sum import Sites
from metafab.cell import CellNumerics, PillarCell, rcwa
from metafab.cell.meep import Pool, SupercellSettings, solve_supercell
from metafab.cell.supercell import Supercell, SupercellResponse
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.layout import Lattice
from metafab.optics import Imaging, PsfNumerics, psf
from metafab.optics.geometry.polarisation import FocusIntegrals

CELL = PillarCell(
    period_nm=(680.0, 680.0),
    width_nm=300.0,
    length_nm=300.0,
    height_nm=1160.0,
    n_pillar=3.478 + 0j,
    n_substrate=(1.444 + 0j, 1.444 + 0j),
    n_ambient=1.0 + 0j,
    wavelength_nm=1550.0,
)
NA = 0.9
SIDES_NM = np.arange(120.0, 581.0, 20.0)
#: Sites without a pillar around the lens, which keep its periodic images apart.
PADDING = 2
#: Half the side and step of the window in the focal plane, um.
REACH_UM, STEP_UM = 3.0, 0.05


@dataclass(frozen=True)
class Lens:
    """Sides of the pillars, and what the library says of them."""

    side_nm: FloatArray  #: Shape (n, n); 0 outside the lens.
    t: ComplexArray  #: Shape (n, n), zero-order t of each pillar in its own lattice; 0 outside.
    focal_um: float  #: Focal length.

    @property
    def aperture_um(self) -> float:
        """Diameter."""
        return len(self.side_nm) * CELL.period_nm[0] * 1e-3


def lens_of(count: int) -> Lens:
    """Choose the sides of a lens of ``count`` sites across, by field overlap and the best constant phase."""
    own = np.array(
        [rcwa.solve(replace(CELL, width_nm=s, length_nm=s), CellNumerics(target_error=1e-3)).t[0, 0] for s in SIDES_NM]
    )
    place = (np.arange(count) - (count - 1) / 2.0) * CELL.period_nm[0] * 1e-3
    radius = np.hypot(place[:, None], place)
    inside = radius <= 0.5 * count * CELL.period_nm[0] * 1e-3
    focal_um = 0.5 * count * CELL.period_nm[0] * 1e-3 / math.tan(math.asin(NA))
    wave = np.exp(-2j * np.pi / (1e-3 * CELL.wavelength_nm) * (np.hypot(radius, focal_um) - focal_um))
    overlaps = [(own * np.conj(wave * np.exp(1j * c))[..., None]).real for c in np.linspace(0.0, 2.0 * np.pi, 64)]
    best = max(overlaps, key=lambda overlap: overlap.max(axis=-1)[inside].sum())
    chosen = best.argmax(axis=-1)
    return Lens(np.where(inside, SIDES_NM[chosen], 0.0), np.where(inside, own[chosen], 0.0), focal_um)


def tangential(answer: SupercellResponse, per_site: int = 4) -> tuple[ComplexArray, FloatArray]:
    """E_x and E_y over incident E where the pillars end, shape (2, n, n), and the places along either axis, um."""
    count = answer.supercell.shape[0] * per_site
    place = (np.arange(count) + 0.5) / count - 0.5
    along_x, along_y = (np.exp(2j * np.pi * answer.order[:, axis, None] * place) for axis in (0, 1))
    field = np.einsum("ok,oy,ox->kyx", answer.amplitude, along_y, along_x, optimize=True)
    return field, place * answer.supercell.period_um[0]


def dyadic(field: ComplexArray, place_um: FloatArray, axis_um: FloatArray, focal_um: float) -> FloatArray:
    """|E|^2 in the focal plane of tangential fields, shape (2, n, n): E = 2 curl of the integral of z x E_t G."""
    k = 2.0 * np.pi / (1e-3 * CELL.wavelength_nm)
    area = (place_um[1] - place_um[0]) ** 2
    e_x, e_y = field
    total = np.empty((axis_um.size, axis_um.size))
    for row, y in enumerate(axis_um.tolist()):
        for column, x in enumerate(axis_um.tolist()):
            to_x, to_y = x - place_um, y - place_um[:, None]
            distance = np.sqrt(to_x**2 + to_y**2 + focal_um**2)
            slope = (1j * k - 1.0 / distance) * np.exp(1j * k * distance) / (2.0 * np.pi * distance**2) * area
            tangential_x, tangential_y = (np.sum(-focal_um * slope * part) for part in (e_x, e_y))
            along = np.sum(slope * (to_x * e_x + to_y * e_y))
            total[row, column] = abs(tangential_x) ** 2 + abs(tangential_y) ** 2 + abs(along) ** 2
    return total


def by_metafab(amplitude: ComplexArray, lens: Lens, *, scalar: bool) -> FloatArray:
    """|E|^2 in the focal plane by the optics room, per unit of incident power; ``amplitude`` is power-normalised."""
    imaging = Imaging(
        wavelength_um=1e-3 * CELL.wavelength_nm,
        focal_length_mm=1e-3 * lens.focal_um,
        split_angle_deg=0.0,
        sensor_distance_um=lens.focal_um,
        pixel_um=STEP_UM,
        aperture_um=lens.aperture_um,
    )
    period_dbu = round(CELL.period_nm[0])
    sites = Sites(Lattice(period_dbu=(period_dbu, period_dbu), shape=amplitude.shape, database_unit_nm=1.0), amplitude)
    points = 2 * round(REACH_UM / STEP_UM) + 2
    numerics = PsfNumerics(window_px=points, target_error=1e-3, vectorial=not scalar, energy=not scalar)
    return psf(sites, imaging, [1e3], numerics).psf[0, 0, 1:, 1:]


def widths_um(image: FloatArray, axis_um: FloatArray) -> tuple[float, float]:
    """Full widths at half maximum along x and y through the axis."""
    spline = RectBivariateSpline(axis_um, axis_um, image)
    fine = np.linspace(0.0, REACH_UM, 6001)
    found = []
    for along_x in (True, False):
        width = 0.0
        for side in (-1.0, 1.0):
            line = (
                spline(0.0 * fine, side * fine, grid=False) if along_x else spline(side * fine, 0.0 * fine, grid=False)
            )
            below = int(np.argmax(line < 0.5 * line[0]))
            width += float(np.interp(0.5 * line[0], line[[below, below - 1]], fine[[below, below - 1]]))
        found.append(width)
    return found[0], found[1]


def ideal(axis_um: FloatArray) -> FloatArray:
    """|E|^2 of the ideal flat lens in x polarised light."""
    wavelength_um = 1e-3 * CELL.wavelength_nm
    x, y = np.meshgrid(axis_um, axis_um)
    radius, inverse = np.unique(np.round(np.hypot(x, y), 9), return_inverse=True)
    field = FocusIntegrals.at(radius / wavelength_um, NA)
    i_0, i_1, i_2 = (part[inverse.ravel()].reshape(x.shape) for part in (field.i_0, field.i_1, field.i_2))
    phi = np.arctan2(y, x)
    e_x, e_y, e_z = i_0 + i_2 * np.cos(2.0 * phi), i_2 * np.sin(2.0 * phi), i_1 * np.cos(phi)
    return np.asarray(e_x**2 + e_y**2 + e_z**2)


def rows(quick: bool, sites: int = 29, pixels_per_period: int = 12) -> list[dict[str, Any]]:
    """Rows of name, error, seconds, peak memory of Meep, widths and peak over Meep's."""
    lens = lens_of(9 if quick else sites)
    inside = lens.side_nm > 0.0
    padded = np.pad(lens.side_nm, PADDING)
    supercell = Supercell(CELL, np.stack([padded, padded], axis=-1))
    start = time.process_time()
    with Pool(1) as pool:
        answer = solve_supercell(supercell, "x", SupercellSettings(pixels_per_period, 1e-2), pool)
    field, place_um = tangential(answer)
    per_site = field.shape[1] // len(padded)
    lit = np.kron(np.pad(inside, PADDING), np.ones((per_site, per_site)))
    axis_um = np.arange(-round(REACH_UM / STEP_UM), round(REACH_UM / STEP_UM) + 1) * STEP_UM
    aperture_um2 = 0.25 * np.pi * lens.aperture_um**2
    n_in, n_out = CELL.n_in[0].real, CELL.n_out[0].real
    meep = dyadic(field * lit, place_um, axis_um, lens.focal_um) * n_out / (n_in * aperture_um2)
    site_um = (np.arange(len(inside)) - (len(inside) - 1) / 2.0) * CELL.period_nm[0] * 1e-3
    s_x, s_y = -site_um / lens.focal_um, -site_um[:, None] / lens.focal_um
    s_z = 1.0 / np.sqrt(1.0 + s_x**2 + s_y**2)
    # E_x of a site of power amplitude a is a (1 - s_x^2 / (1 + s_z)) / sqrt(s_z).
    per_e_x = np.sqrt(s_z) / (1.0 - (s_x * s_z) ** 2 / (1.0 + s_z))
    e_x = supercell.at_sites(answer.order, answer.amplitude[:, 0])[PADDING:-PADDING, PADDING:-PADDING]
    lone = answer.responses[PADDING:-PADDING, PADDING:-PADDING] * inside
    power = math.sqrt(n_out / n_in)
    found = {
        "Meep": meep,
        "library and vectorial focusing": by_metafab(power * lens.t, lens, scalar=False),
        "lone pillars on Meep's grid": by_metafab(power * lone, lens, scalar=False),
        "Meep's E_x and vectorial focusing": by_metafab(power * e_x * inside * per_e_x, lens, scalar=False),
        "library and scalar focusing": by_metafab(power * lens.t, lens, scalar=True),
        "ideal flat lens": ideal(axis_um),
    }
    seconds, spent = time.process_time() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    table = []
    for name, image in found.items():
        along_x, along_y = widths_um(image, axis_um)
        difference = image / image.max() - meep / meep.max()
        table.append(
            {
                "name": name,
                "error": float(np.linalg.norm(difference) / np.linalg.norm(meep / meep.max())),
                "seconds": spent.ru_utime + spent.ru_stime if name == "Meep" else seconds,
                "peak_rss_mb": spent.ru_maxrss * 1024 / 1e6,
                "fwhm_x_um": along_x,
                "fwhm_y_um": along_y,
                "ellipticity": along_x / along_y,
                "peak_over_meep": float(image.max() / meep.max()) if name != "ideal flat lens" else math.nan,
            }
        )
    return table


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--sites", type=int, default=29)
    parser.add_argument("--pixels", type=int, default=12)
    given = parser.parse_args()
    print(json.dumps(rows(given.quick, given.sites, given.pixels), indent=2))
