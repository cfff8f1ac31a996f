"""Worker program for FDTD, run by an interpreter that has Meep; :mod:`metafab.cell.meep` drives it.

It uses the standard library, NumPy and Meep only. JSON objects, one a line, come in on stdin and go out on stdout:

- ``{"id", "job", "arrays"}`` starts one run; ``arrays`` is the path of the .npz file to write
- ``{"id", "progress"}`` reports the simulated time during the run
- ``{"id", "done", "seconds"}`` or ``{"id", "error"}`` ends the run

``--probe`` prints one object with the result of :func:`probe`, and exits.

Lengths are micrometres and times micrometres / c, as in Meep; fields depend on time as exp(-i omega t).
"""

from __future__ import annotations

import json
import math
import os
import sys
import threading
import time
from typing import Any

import numpy as np

Json = dict[str, Any]  # Python 3.9 and later

#: Relative width of the pulse (Meep's ``fwidth``): it dies soon and excites few modes far from the design wavelength.
_PULSE_WIDTH = 0.5
_PULSE_CUTOFF = 5.0
#: Optical periods between samples of the running Fourier transform.
_SAMPLE_PERIODS = 1.25
#: Modes of a decaying tail, and the number of samples from which they are fitted.
_TAIL_MODES = 6
_TAIL_SAMPLES = 3 * _TAIL_MODES
#: Number of consecutive limits that must agree.
_AGREEING_LIMITS = 3


def tail_limit(samples: Any, modes: int = _TAIL_MODES) -> Any:
    """Limit of a sequence whose tail is a sum of decaying oscillations, by reduced rank extrapolation.

    With s_j = s + sum_m c_m q_m^j, weights a_k that annihilate the differences of the window and add up to one
    give s = sum_k a_k s_(j+k), exactly where at most ``modes`` of the q_m matter (Sidi, Vector Extrapolation
    Methods, 2017, ch. 1). Modes of high quality need not decay first.

    ``samples`` has the shape (n_samples, n_values), n_samples >= 2 (modes + 1); the limit has the shape (n_values,).
    """
    window = np.asarray(samples)
    change = np.diff(window, axis=0)
    rows = change.shape[0] - modes
    # Each value gives one Hankel block; all share the decay rates.
    hankel = np.concatenate([[change[row : row + modes + 1, i] for row in range(rows)] for i in range(window.shape[1])])
    size = float(np.max(np.abs(hankel)))
    if size == 0.0:
        return window[-1].copy()
    # Minimise |hankel a| with sum(a) = 1; the small ridge keeps noise at round-off level out of the weights.
    normal = hankel.conj().T @ hankel / size**2
    normal += 1e-15 * np.trace(normal).real * np.eye(modes + 1)
    weights = np.linalg.solve(normal, np.ones(modes + 1))
    weights /= weights.sum()
    return weights @ window[-(modes + 1) :]


def run(job: Json, report: Any) -> Json:
    """Drive one plane-wave pulse through a periodic structure.

    Args:
        job: fields of :class:`metafab.cell.meep.protocol.Job`.
        report: callback with the simulated time.

    Returns:
        Arrays of the reply: ``time`` of shape (n_samples,), ``amplitude`` of shape (n_samples, n_monitors,
        n_components, n_orders), ``limit`` of shape (n_monitors, n_components, n_orders), ``tail`` (scalar, largest
        change of the last limits) and ``incident`` of shape (n_monitors,).
    """
    import meep as mp

    mp.verbosity(0)
    # The empty cell is uniform across the wave, so that two pixels suffice.
    nothing = {"n_x": 2, "n_y": 2, "blocks": [], "mirrors": [], "orders": [(0, 0)], "weight": [1.0, 1.0]}
    empty_job = {**job, **nothing}
    empty = _simulation(mp, empty_job)
    monitors = _monitors(mp, empty_job, empty)
    pulse = 2.0 * _PULSE_CUTOFF * job["wavelength_um"] / _PULSE_WIDTH
    # After the pulse only the absorber's echo remains: two passes through the cell are ample.
    slowness = max(abs(complex(*epsilon)) for epsilon in job["epsilon_in"]) ** 0.5
    empty.run(until=pulse + 2.0 * slowness * job["n_z"] * job["pixel_um"])
    co_polarised = job["components"].index(job["polarisation"])
    incident = _amplitudes(mp, empty_job, empty, monitors)[:, co_polarised, 0]
    empty.reset_meep()

    cell = _simulation(mp, job)
    monitors = _monitors(mp, job, cell)
    step = _SAMPLE_PERIODS * job["wavelength_um"]
    scale = float(np.max(np.abs(incident)))
    times, samples, limits = [], [], []
    cell.run(until=pulse)
    tail = math.inf
    while True:
        times.append(cell.meep_time())
        samples.append(_amplitudes(mp, job, cell, monitors))
        report(times[-1])
        if len(samples) >= _TAIL_SAMPLES:
            limits.append(tail_limit(np.reshape(samples[-_TAIL_SAMPLES:], (_TAIL_SAMPLES, -1))))
        if len(limits) > _AGREEING_LIMITS:
            recent = np.array(limits[-_AGREEING_LIMITS - 1 :])
            tail = float(np.max(np.abs(np.diff(recent, axis=0)))) / scale
            if tail <= job["decay"]:
                break
        if times[-1] >= job["longest_time"]:
            break
        cell.run(until=step)
    if not limits:
        limits.append(np.ravel(samples[-1]))
    cell.reset_meep()
    return {
        "time": np.array(times),
        "amplitude": np.array(samples),
        "limit": limits[-1].reshape(samples[-1].shape),
        "tail": np.array(tail),
        "incident": incident,
    }


def _medium(mp: Any, job: Json, epsilon: Any, mu: Any = (1.0, 1.0, 1.0)) -> Any:
    """A material without dispersion, its loss exact at the design wavelength."""
    values = [complex(*axis) for axis in epsilon]
    omega = 2.0 * math.pi / job["wavelength_um"]
    return mp.Medium(
        epsilon_diag=mp.Vector3(*(e.real for e in values)),
        mu_diag=mp.Vector3(*mu),
        D_conductivity_diag=mp.Vector3(*(omega * e.imag / e.real for e in values)),
    )


def _z(job: Json, node: float) -> float:
    """Meep's z of a node: its origin is the middle of the cell."""
    return float((node - job["n_z"] / 2) * job["pixel_um"])


def _component(mp: Any, polarisation: str) -> Any:
    return mp.Ex if polarisation == "x" else mp.Ey


def _solid(mp: Any, job: Json, block: Json) -> Any:
    """A box, or the prism of its outline."""
    low, high = np.array(block["low"]), np.array(block["high"])
    material = _medium(mp, job, block["epsilon"], block["mu"])
    if not block["outline"]:
        return mp.Block(center=mp.Vector3(*((low + high) / 2.0)), size=mp.Vector3(*(high - low)), material=material)
    vertices = [mp.Vector3(x, y, low[2]) for x, y in block["outline"]]
    return mp.Prism(vertices, height=float(high[2] - low[2]), axis=mp.Vector3(z=1.0), material=material)


def _simulation(mp: Any, job: Json) -> Any:
    pixel, frequency = job["pixel_um"], 1.0 / job["wavelength_um"]
    width, length = job["n_x"] * pixel, job["n_y"] * pixel
    x_polarised = job["polarisation"] == "x"
    geometry = [_solid(mp, job, block) for block in job["blocks"]]
    mirrors = []
    for name in job["mirrors"]:
        # The source is a polar vector: odd under the mirror across its own axis.
        phase = -1 if name == job["polarisation"] else 1
        mirrors.append(mp.Mirror(mp.X if name == "x" else mp.Y, phase=phase))

    def weight(place: Any) -> complex:
        across = place.y if x_polarised else place.x
        node = round(across / pixel + len(job["weight"]) / 2)
        return complex(job["weight"][node % len(job["weight"])])

    source = mp.Source(
        mp.GaussianSource(frequency, fwidth=_PULSE_WIDTH * frequency, cutoff=_PULSE_CUTOFF),
        component=_component(mp, job["polarisation"]),
        center=mp.Vector3(z=_z(job, job["source_node"])),
        size=mp.Vector3(width, length),
        amp_func=None if len(set(job["weight"])) == 1 else weight,
    )
    return mp.Simulation(
        cell_size=mp.Vector3(width, length, job["n_z"] * pixel),
        resolution=1.0 / pixel,
        Courant=job["courant"],
        geometry=geometry,
        eps_averaging=job["smooth"],
        # Otherwise blocks that leave the cell re-enter at its other end, along z too.
        ensure_periodicity=False,
        default_material=_medium(mp, job, job["epsilon_in"]),
        boundary_layers=[mp.PML(job["absorber_nodes"] * pixel, direction=mp.Z)],
        k_point=mp.Vector3(),
        symmetries=mirrors,
        sources=[source],
    )


def _monitors(mp: Any, job: Json, simulation: Any) -> list[Any]:
    width, length = job["n_x"] * job["pixel_um"], job["n_y"] * job["pixel_um"]
    components = [_component(mp, name) for name in job["components"]]
    return [
        simulation.add_dft_fields(
            components,
            1.0 / job["wavelength_um"],
            0,
            1,
            center=mp.Vector3(z=_z(job, node)),
            size=mp.Vector3(width, length),
            yee_grid=True,
        )
        for node in job["monitor_nodes"]
    ]


def _plane(mp: Any, job: Json, simulation: Any, monitor: Any, component: str) -> Any:
    """One period of a monitor's field on the component's grid points, shape (n_y, n_x)."""
    field = simulation.get_dft_array(monitor, _component(mp, component), 0)
    # Meep adds the periodic images at the edges: one where points lie on the edge, two where they straddle it.
    n_x, n_y = job["n_x"], job["n_y"]
    left, below = (field.shape[0] - n_x) // 2, (field.shape[1] - n_y) // 2
    return field[left : left + n_x, below : below + n_y].T


def _amplitudes(mp: Any, job: Json, simulation: Any, monitors: list[Any]) -> Any:
    """Diffraction orders of each monitor and component, shape (n_monitors, n_components, n_orders).

    The cell average over the grid points removes every other order exactly.
    """
    orders, shape = np.array(job["orders"]), (job["n_x"], job["n_y"])
    weighted = 1 if job["polarisation"] == "x" else 0
    result = np.empty((len(monitors), len(job["components"]), len(orders)), dtype=complex)
    for j, component in enumerate(job["components"]):
        # E_x lies half a pixel along x from the nodes, E_y along y; the first node is the cell's edge.
        along = []
        for axis, name in enumerate("xy"):
            place = (np.arange(shape[axis]) + (0.5 if component == name else 0.0)) / shape[axis] - 0.5
            along.append(np.exp(-2j * np.pi * orders[:, axis, None] * place) / shape[axis])
        along[weighted] = along[weighted] * np.asarray(job["weight"])
        for i, monitor in enumerate(monitors):
            field = _plane(mp, job, simulation, monitor, component)
            result[i, j] = np.sum((along[1] @ field) * along[0], axis=1)
    return result


def probe() -> Json:
    """Test whether this interpreter's ``meep`` is the FDTD program, by the phase of a wave in vacuum."""
    answer = {"python": ".".join(map(str, sys.version_info[:3])), "found": False, "version": "", "reason": ""}
    try:
        import meep as mp
    except Exception as error:  # a broken installation may raise anything
        answer["reason"] = f"import failed: {type(error).__name__}: {error}"
        return answer
    answer["version"] = str(getattr(mp, "__version__", ""))
    missing = [name for name in ("Simulation", "PML", "GaussianSource", "Medium", "Mirror") if not hasattr(mp, name)]
    if missing:
        answer["reason"] = f"its package `meep` is not the FDTD program (no {', '.join(missing)})"
        return answer
    try:
        mp.verbosity(0)
        simulation = mp.Simulation(
            cell_size=mp.Vector3(z=4.0),
            resolution=20,
            dimensions=1,
            boundary_layers=[mp.PML(1.0)],
            sources=[mp.Source(mp.GaussianSource(1.0, fwidth=0.5), component=mp.Ex, center=mp.Vector3(z=-0.9))],
        )
        planes = [
            simulation.add_dft_fields([mp.Ex], 1.0, 0, 1, center=mp.Vector3(z=z), size=mp.Vector3())
            for z in (-0.25, 0.25)
        ]
        simulation.run(until=25)
        first, second = (complex(simulation.get_dft_array(plane, mp.Ex, 0)) for plane in planes)
    except Exception as error:
        answer["reason"] = f"it failed in vacuum: {type(error).__name__}: {error}"
        return answer
    # Half a wavelength inverts the field; the dispersion of the grid is 4e-3 of that.
    if abs(second / first + 1.0) > 0.05:
        answer["reason"] = "its waves do not travel as they should in vacuum"
        return answer
    answer["found"] = True
    return answer


def serve(stream: Any) -> None:
    """Answer jobs until stdin ends, or the parent process is gone."""
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(3)

    threading.Thread(target=watch, daemon=True).start()

    def say(message: Json) -> None:
        stream.write(json.dumps(message) + "\n")
        stream.flush()

    for line in sys.stdin:
        message = json.loads(line)
        name = message["id"]

        def report(done: float, name: Any = name) -> None:
            if os.getppid() != parent:
                os._exit(3)
            say({"id": name, "progress": done})

        start = time.perf_counter()
        try:
            arrays = run(message["job"], report)
            np.savez(message["arrays"], **arrays)
        except Exception as error:
            say({"id": name, "error": f"{type(error).__name__}: {error}"})
        else:
            say({"id": name, "done": True, "seconds": time.perf_counter() - start})


def main() -> None:
    """Run as a program. The protocol keeps the real stdout; Meep's prints, C++ ones included, go to stderr."""
    sys.stdout.flush()
    protocol = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    if sys.argv[1:] == ["--probe"]:
        protocol.write(json.dumps(probe()) + "\n")
        protocol.flush()
    else:
        serve(protocol)


if __name__ == "__main__":
    main()
