"""A plain Meep script for one unit cell, as tutorials write it: whole cell, walls anywhere, a long wait.

It runs in an interpreter that has Meep, reads the cell as JSON from stdin, and prints t and the seconds of both runs.
``benchmarks/cell/meep.py`` compares the driver with it.
"""

import cmath
import json
import math
import sys
import time

import meep as mp
import numpy as np

#: Simulated time after the source has ended, um / c: 62 optical periods.
WAIT_UM = 50.0


def main() -> None:
    """Empty run, run with the pillar, t in the planes of the conventions."""
    cell = json.load(sys.stdin)
    mp.verbosity(0)
    wavelength, period, height = cell["wavelength_um"], cell["period_um"], cell["height_um"]
    n_in, n_out, n_pillar = cell["n_in"], cell["n_out"], complex(*cell["n_pillar"])
    absorber, gap = 0.4, 0.5
    size_z = 2 * absorber + 2 * gap + height
    foot = -0.5 * size_z + absorber + gap
    source_z, far_z = foot - 0.7 * gap, foot + height + 0.7 * gap
    epsilon = n_pillar**2
    silicon = mp.Medium(epsilon=epsilon.real, D_conductivity=2 * math.pi / wavelength * epsilon.imag / epsilon.real)
    geometry = [
        # It ends with the cell: beyond, Meep would let it re-enter at the other end.
        mp.Block(
            size=mp.Vector3(mp.inf, mp.inf, foot + 0.5 * size_z),
            center=mp.Vector3(z=0.5 * (foot - 0.5 * size_z)),
            material=mp.Medium(index=n_in),
        ),
        mp.Block(
            size=mp.Vector3(cell["width_um"], cell["length_um"], height),
            center=mp.Vector3(z=foot + 0.5 * height),
            material=silicon,
        ),
    ]

    def field(structure: list, default: mp.Medium) -> complex:
        """Cell average of E_x behind the pillar."""
        simulation = mp.Simulation(
            cell_size=mp.Vector3(period, period, size_z),
            resolution=cell["pixels_per_um"],
            geometry=structure,
            default_material=default,
            boundary_layers=[mp.PML(absorber, direction=mp.Z)],
            k_point=mp.Vector3(),
            sources=[
                mp.Source(
                    mp.GaussianSource(1 / wavelength, fwidth=0.2 / wavelength),
                    component=mp.Ex,
                    center=mp.Vector3(z=source_z),
                    size=mp.Vector3(period, period),
                )
            ],
        )
        plane = mp.Vector3(period, period)
        monitor = simulation.add_dft_fields([mp.Ex], 1 / wavelength, 0, 1, center=mp.Vector3(z=far_z), size=plane)
        simulation.run(until_after_sources=WAIT_UM)
        return complex(np.mean(simulation.get_dft_array(monitor, mp.Ex, 0)))

    start = time.process_time()
    # The empty run has the substrate's index everywhere; its phase is removed below.
    empty = field([], mp.Medium(index=n_in))
    behind = field(geometry, mp.Medium(index=n_out))
    seconds = time.process_time() - start
    k = 2 * math.pi / wavelength
    arriving = empty * cmath.exp(1j * k * n_in * (foot - far_z))
    t = behind * cmath.exp(-1j * k * n_out * (far_z - foot - height)) / arriving
    print(json.dumps({"t": [t.real, t.imag], "seconds": seconds}))


if __name__ == "__main__":
    main()
