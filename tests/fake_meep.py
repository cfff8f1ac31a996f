"""In place of Meep: pillars that answer by a closed form and do not couple, waves that run as on the grid."""

from __future__ import annotations

import cmath
import math

import numpy as np

from metafab.cell.meep import Pool
from metafab.cell.meep.grid import grid_wavenumber
from metafab.cell.meep.protocol import Job, Reply


def response(width_nm: float, length_nm: float) -> complex:
    """t of a pillar alone, for either polarisation; an empty site has that of no pillar."""
    return cmath.rect(0.6 + 0.001 * length_nm, 0.02 * width_nm - 0.005 * length_nm)


class UncoupledPillars(Pool):
    """Answers the jobs of supercells.

    Args:
        planted: added to the amplitude of each order (m, n) of a supercell of several pillars.
        tail: what every reply says is left of its field.
    """

    def __init__(self, planted: dict[tuple[int, int], complex] | None = None, tail: float = 1e-4) -> None:
        super().__init__(1)
        self.tail = tail
        self.planted = planted or {}
        self.jobs: list[Job] = []

    def run(self, job: Job, report: object = None) -> Reply:
        """The reply that de-embedding turns into the closed form."""
        self.jobs.append(job)
        low, high = (np.array([getattr(b, end) for b in job.blocks[1:-1]]).reshape(-1, 3) for end in ("low", "high"))
        size_nm = 1e3 * (high - low)[:, :2]
        period = np.array([job.n_x, job.n_y]) * job.pixel_um
        place = 0.5 * (low + high)[:, :2] / period
        sites = max(1, round(float(period[0] * period[1]) / self.site_um2))
        empty = sites - len(size_nm)
        assert empty in {0, sites}, "the fake knows no mixture of pillars and gaps"
        own = np.array([response(*size) for size in size_nm]) if len(size_nm) else np.array([response(0.0, 0.0)])
        orders = np.array(job.orders)
        amplitude = np.exp(-2j * np.pi * orders @ place.T) @ own / sites if len(size_nm) else own[:1]
        if sites > 1:
            amplitude = amplitude + np.array([self.planted.get(order, 0.0) for order in job.orders])
        near, far = job.monitor_nodes
        start = job.blocks[0].low[2]  # where the ambient begins: the foot
        begin = start / job.pixel_um + job.n_z / 2
        end = begin + self.height_um / job.pixel_um
        n_in, n_out = math.sqrt(job.epsilon_in[0].real), math.sqrt(job.blocks[0].epsilon[0].real)
        own_axis = "xy".index(job.polarisation)

        def wave(n: float, nodes: float, order: np.ndarray) -> complex:
            across = tuple(2.0 * np.pi * order / period)
            k = grid_wavenumber(n, job.wavelength_um, job.pixel_um, job.courant, across)  # type: ignore[arg-type]
            return cmath.exp(1j * k * nodes * job.pixel_um)

        source = 0.8 * cmath.exp(0.4j)
        limit = np.zeros((2, 2, len(orders)), dtype=complex)
        limit[1, own_axis] = [source * a * wave(n_out, far - end, o) for a, o in zip(amplitude, orders, strict=True)]
        return {
            "limit": limit,
            "incident": np.array([source * wave(n_in, near - begin, np.zeros(2)), 0.0]),
            "tail": np.array(self.tail),
            "time": np.array([50.0]),
            "seconds": np.array(0.1),
        }

    #: Of one site and of the pillars; tests with other cells set their own.
    site_um2 = 0.35 * 0.35
    height_um = 0.6
