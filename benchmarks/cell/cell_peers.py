"""Other Fourier modal solvers on the paper's pillars, each in the formulation that converges best for it.

Run as a program by an interpreter that has the peers (``benchmarks/cell/peers.txt``); neither metafab nor its packages
need to be there. It reads one JSON object from stdin, ``{"peer": name, "pillars": [...], "longest_s": s}``, where a
pillar has the keys of :class:`Pillar`, and writes one JSON line for each truncation: ``{"orders": n, "t": [[[re, im],
[re, im]], ...], "seconds": [...], "peak_rss_mb": mb}`` with t_xx and t_yy of each pillar by metafab's conventions.
Truncations rise until the next is expected to take more than ``longest_s`` seconds of processor time per pillar.
Importing, compiling and one warm-up are not counted.

All solve for the zero order of light along z from the substrate, both polarisations at once, in double precision and on
one thread. Where a code takes a permittivity as a raster, the raster is 0.5 nm, which is exact for pillars of whole
nanometres; where it takes Fourier coefficients or rectangles, these are given in closed form.
"""

from __future__ import annotations

import json
import os
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

RASTER_NM = 0.5
#: Cosines M besides the constant: (2 M + 1)^2 orders. Peers with circular truncations have nearly as many.
RUNGS = (3, 5, 7, 9, 11, 13, 15, 17, 19)


@dataclass(frozen=True)
class Pillar:
    """A rectangular pillar on a square lattice; light comes from the substrate along z."""

    period_nm: float  #: Period of both axes.
    width_nm: float  #: Size along x, 0 to the period.
    length_nm: float  #: Size along y.
    height_nm: float  #: Size along z.
    wavelength_nm: float  #: Vacuum wavelength.
    n_pillar: tuple[float, float]  #: Index of the pillar, [real, imaginary]; Im > 0 absorbs.
    n_substrate: float  #: Real index of the substrate.
    n_ambient: float  #: Real index around and above the pillar.

    @property
    def index(self) -> complex:
        """Complex index of the pillar."""
        return complex(*self.n_pillar)

    def raster(self) -> Any:
        """Permittivity on pixels of RASTER_NM with the pillar in the middle, shape (n_x, n_y)."""
        pixels = round(self.period_nm / RASTER_NM)
        at_nm = np.abs(np.arange(pixels) + 0.5 - pixels / 2) * RASTER_NM
        inside = (at_nm[:, None] < self.width_nm / 2) & (at_nm < self.length_nm / 2)
        return np.where(inside, self.index**2, self.n_ambient**2)

    def normal_field(self) -> tuple[Any, Any]:
        """(x, y) components of the nearest wall's normal on the pixels of the raster, each of shape (n_x, n_y)."""
        pixels = round(self.period_nm / RASTER_NM)
        at_nm = np.abs(np.arange(pixels) + 0.5 - pixels / 2) * RASTER_NM
        along_x = (at_nm - self.width_nm / 2)[:, None] > (at_nm - self.length_nm / 2)
        return along_x + 0j, ~along_x + 0j

    def coefficient(self, m: Any, n: Any) -> Any:
        """Fourier coefficients of the permittivity at orders (m, n), in closed form; arrays of any shape."""
        fill_x, fill_y = self.width_nm / self.period_nm, self.length_nm / self.period_nm
        shape = fill_x * np.sinc(m * fill_x) * fill_y * np.sinc(n * fill_y)
        around = self.n_ambient**2
        return (self.index**2 - around) * shape + around * ((m == 0) & (n == 0))


#: (orders, t_xx, t_yy)
Answer = tuple[int, complex, complex]
Peer = Callable[[Pillar, int], Answer]


def fmmax() -> Peer:
    """The vector formulation of fmmax (jax) with a rectangle's exact normal field, better here than its own fields."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import jax.numpy as jnp
    from fmmax import basis, fmm, scattering

    compiled: dict[int, Any] = {}

    def solve(media: Any, tangent: Any, wavelength: Any, period: Any, height: Any, expansion: Any) -> Any:
        lattice = basis.LatticeVectors(u=period * basis.X, v=period * basis.Y)
        layers = [
            fmm.eigensolve_isotropic_media(wavelength, jnp.zeros(2), lattice, each, expansion, lambda *_: tangent)
            for each in media
        ]
        zero = jnp.zeros(())
        s11 = scattering.stack_s_matrix(layers, [zero, height, zero]).s11
        return s11[0, 0], s11[expansion.num_terms, expansion.num_terms]

    def run(pillar: Pillar, rung: int) -> Answer:
        lattice = basis.LatticeVectors(u=pillar.period_nm * basis.X, v=pillar.period_nm * basis.Y)
        expansion = basis.generate_expansion(lattice, (2 * rung + 1) ** 2, basis.Truncation.CIRCULAR)
        substrate, ambient = (jnp.full((1, 1), n**2 + 0j) for n in (pillar.n_substrate, pillar.n_ambient))
        media = (substrate, jnp.asarray(pillar.raster()), ambient)
        x, y = pillar.normal_field()
        tangent = (jnp.asarray(-y), jnp.asarray(x))
        lengths = (jnp.asarray(each) for each in (pillar.wavelength_nm, pillar.period_nm, pillar.height_nm))
        inputs = (media, tangent, *lengths)
        if rung not in compiled:
            compiled[rung] = jax.jit(solve, static_argnums=5).lower(*inputs, expansion).compile()
        # Amplitudes are those of H = n E; the first half of them H_x, which goes with E_y.
        t_yy, t_xx = (complex(each) * pillar.n_substrate / pillar.n_ambient for each in compiled[rung](*inputs))
        return expansion.num_terms, t_xx, t_yy

    return run


def meent() -> Peer:
    """Rectangles without a raster in meent (numpy), by Li's inverse and direct rules along either axis."""
    from meent import call_mee

    def run(pillar: Pillar, rung: int) -> Answer:
        middle = pillar.period_nm / 2
        # meent's time dependence is exp(+i omega t): absorption and phases have the other sign.
        rectangle = ["rectangle", middle, middle, pillar.width_nm, pillar.length_nm, pillar.index.conjugate()]
        solver = call_mee(
            backend=0,
            n_top=pillar.n_substrate,
            n_bot=pillar.n_ambient,
            theta=0.0,
            phi=0.0,
            psi=0.0,
            wavelength=pillar.wavelength_nm,
            period=[pillar.period_nm, pillar.period_nm],
            fto=[rung, rung],
            thickness=[pillar.height_nm],
            ucell=[[pillar.n_ambient, [rectangle]]],
        )
        result = solver.conv_solve()
        # TM amplitudes are those of i H = i n E.
        t_xx = 1j * result.res_tm_inc.T_p[rung, rung].conjugate() / pillar.n_ambient
        t_yy = result.res_te_inc.T_s[rung, rung].conjugate()
        return (2 * rung + 1) ** 2, complex(t_xx), complex(t_yy)

    return run


def grcwa() -> Peer:
    """The one formulation of grcwa (numpy): one permittivity matrix for all components."""
    import grcwa as package
    from grcwa.rcwa import GetSMatrix

    def run(pillar: Pillar, rung: int) -> Answer:
        lattice = [pillar.period_nm, 0.0], [0.0, pillar.period_nm]
        layers = package.obj((2 * rung + 1) ** 2, *lattice, 1.0 / pillar.wavelength_nm, 0.0, 0.0, verbose=0)
        epsilon = pillar.raster()
        layers.Add_LayerUniform(0.0, pillar.n_substrate**2)
        layers.Add_LayerGrid(pillar.height_nm, *epsilon.shape)
        layers.Add_LayerUniform(0.0, pillar.n_ambient**2)
        layers.Init_Setup()
        layers.GridLayer_geteps(epsilon.ravel())
        through = GetSMatrix(0, 2, layers.q_list, layers.phi_list, layers.kp_list, layers.thickness_list)[0]
        scale = pillar.n_substrate / pillar.n_ambient
        return layers.nG, complex(through[layers.nG, layers.nG] * scale), complex(through[0, 0] * scale)

    return run


def torcwa() -> Peer:
    """The one formulation of torcwa (torch), equal to grcwa's, with coefficients in closed form."""
    import torch
    import torcwa as package

    torch.set_num_threads(1)

    def run(pillar: Pillar, rung: int) -> Answer:
        order = np.arange(-rung, rung + 1)
        m, n = (each.ravel() for each in np.meshgrid(order, order, indexing="ij"))
        matrix = torch.as_tensor(pillar.coefficient(m[:, None] - m, n[:, None] - n))
        solver = package.rcwa(
            freq=1.0 / pillar.wavelength_nm,
            order=[rung, rung],
            L=[pillar.period_nm, pillar.period_nm],
            dtype=torch.complex128,
            device=torch.device("cpu"),
            stable_eig_grad=False,
        )
        solver._material_conv = lambda _: matrix
        solver.add_input_layer(eps=pillar.n_substrate**2)
        solver.add_output_layer(eps=pillar.n_ambient**2)
        solver.set_incident_angle(0.0, 0.0)
        solver.add_layer(thickness=pillar.height_nm, eps=matrix)
        solver.solve_global_smatrix()
        t_xx, t_yy = (
            complex(solver.S_parameters([0, 0], polarization=each, power_norm=False)[0]) for each in ("xx", "yy")
        )
        return m.size, t_xx, t_yy

    return run


def inkstone() -> Peer:
    """A rectangle in closed form by inkstone (numpy), without its damping, which slows convergence here."""
    from inkstone import Inkstone

    def run(pillar: Pillar, rung: int) -> Answer:
        solver = Inkstone()
        solver.lattice = ((pillar.period_nm, 0.0), (0.0, pillar.period_nm))
        solver.num_g = (2 * rung + 1) ** 2
        solver.frequency = 1.0 / pillar.wavelength_nm
        for name, index in (("substrate", pillar.n_substrate), ("ambient", pillar.n_ambient), ("pillar", pillar.index)):
            solver.AddMaterial(name, index**2)
        solver.AddLayer("in", 0.0, "substrate")
        solver.AddLayer("layer", pillar.height_nm, "ambient")
        solver.AddLayer("out", 0.0, "ambient")
        solver.AddPatternRectangle("layer", "pillar", (pillar.width_nm, pillar.length_nm), if_gibbs_correction=False)
        t = []
        for s, p in ((0.0, 1.0), (1.0, 0.0)):
            solver.SetExcitation(theta=0.0, phi=0.0, s_amplitude=s, p_amplitude=p)
            for layer in ("in", "out"):
                solver.GetPowerFlux(layer)  # computes the amplitudes
            sent, gone = (solver.GetAmplitudesByOrder(layer, 0.0) for layer in ("in", "out"))
            component = 0 if p else 2
            t.append(complex((gone[component] / sent[component]).item()))
        return solver.num_g, *t

    return run


def nannos() -> Peer:
    """The vector formulation of nannos (numpy) with a rectangle's exact field, better here than its own."""
    import nannos as package

    package.logger.setLevel("ERROR")

    def run(pillar: Pillar, rung: int) -> Answer:
        epsilon = pillar.raster()
        lattice = package.Lattice(([pillar.period_nm, 0.0], [0.0, pillar.period_nm]), discretization=epsilon.shape)
        layer = lattice.Layer("Pillar", thickness=pillar.height_nm)
        layer.epsilon = epsilon
        layer.tangent_field = list(pillar.normal_field())
        stack = [
            lattice.Layer("Superstrate", epsilon=pillar.n_substrate**2),
            layer,
            lattice.Layer("Substrate", epsilon=pillar.n_ambient**2),
        ]
        wave = package.PlaneWave(wavelength=pillar.wavelength_nm, angles=(0.0, 0.0, 0.0))
        solver = package.Simulation(stack, wave, (2 * rung + 1) ** 2, formulation="tangent")
        through = solver.get_S_matrix()[0][0]
        place, scale = solver.index_zeroth_order, pillar.n_substrate / pillar.n_ambient
        t_yy, t_xx = (complex(through[at, at] * scale) for at in (place, solver.nh + place))
        return int(solver.nh), t_xx, t_yy

    return run


def torchrdit() -> Peer:
    """The RCWA of torchrdit (torch) in its Jones vector formulation, which converges best here of its four.

    It makes its own field of normals.
    """
    # Else a search for that field is compiled for minutes at each truncation.
    os.environ["TORCHDYNAMO_DISABLE"] = "1"
    import torch
    from torchrdit.constants import Algorithm, Precision
    from torchrdit.solver import create_solver
    from torchrdit.utils import create_material

    torch.set_num_threads(1)

    def run(pillar: Pillar, rung: int) -> Answer:
        # Version 0.2.0 lowers the permittivity of a pattern by 1, unless it stands in "air", whose index is 1.
        media = {
            "substrate": pillar.n_substrate**2,
            "pillar": pillar.index**2 + 1.0,
            "ambient": pillar.n_ambient**2,
        }
        epsilon, period = pillar.raster(), torch.eye(2, dtype=torch.float64) * pillar.period_nm
        solver = create_solver(
            algorithm=Algorithm.RCWA,
            precision=Precision.DOUBLE,
            lam0=np.array([pillar.wavelength_nm]),
            lengthunit="nm",
            grids=list(epsilon.shape),
            harmonics=[2 * rung + 1, 2 * rung + 1],
            materiallist=[create_material(name=name, permittivity=value) for name, value in media.items()],
            t1=period[:1],
            t2=period[1:],
            is_use_FFF=True,
            fff_vector_scheme="JONES",
        )
        solver.update_ref_material("substrate")
        solver.update_trn_material("ambient")
        solver.add_layer("pillar", torch.tensor(pillar.height_nm, dtype=torch.float64), is_homogeneous=False)
        solver.update_er_with_mask(torch.as_tensor((epsilon != pillar.n_ambient**2).astype(float)), 0, "ambient")
        # The time dependence is exp(+i omega t); TM is E_x, and TE is E_y.
        found = solver.solve([solver.add_source(0.0, 0.0, te, 1.0 - te) for te in (0.0, 1.0)])
        x, y, _ = found.get_zero_order_transmission()
        return (2 * rung + 1) ** 2, x[0].item().conjugate(), y[1].item().conjugate()

    return run


PEERS: dict[str, Callable[[], Peer]] = {
    each.__name__: each for each in (fmmax, meent, grcwa, torcwa, inkstone, nannos, torchrdit)
}


def main() -> None:
    """Answer the job on stdin."""
    job = json.load(sys.stdin)
    pillars = [Pillar(**pillar) for pillar in job["pillars"]]
    run = PEERS[job["peer"]]()
    run(pillars[0], 2)
    for rung, following in zip(RUNGS, (*RUNGS[1:], None), strict=True):
        if job["peer"] == "fmmax":
            run(pillars[0], rung)  # compiles
        answers, seconds = [], []
        for pillar in pillars:
            start = time.process_time()
            answers.append(run(pillar, rung))
            seconds.append(time.process_time() - start)
        line = {
            "orders": answers[0][0],
            "t": [[[t.real, t.imag] for t in answer[1:]] for answer in answers],
            "seconds": seconds,
            "peak_rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6,
        }
        print(json.dumps(line), flush=True)
        # The time of dense eigenvectors grows as the cube of the number of orders.
        if following is None or min(seconds) * ((2 * following + 1) / (2 * rung + 1)) ** 6 > job["longest_s"]:
            return


if __name__ == "__main__":
    main()
