"""Examination of the machine: Python, libraries, Meep, MPI, KLayout, and a short self-test."""

from __future__ import annotations

import platform
import shutil
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from metafab import __version__
from metafab.core.parallel.executor import default_workers
from metafab.core.parallel.progress import Progress, silent
from metafab.run import versions


@dataclass(frozen=True)
class MeepFindings:
    """Interpreters that were tried for Meep."""

    found: bool  #: Whether one of them imports Meep.
    version: str | None  #: Version of Meep.
    python: str | None  #: Path of the interpreter.
    tried: Sequence[Any]  #: All candidates.
    finished_runs: Path | None  #: Folder in which finished simulations are kept.


@dataclass(frozen=True)
class KLayoutFindings:
    """Forms in which KLayout is installed."""

    python: bool  #: Whether the Python package is installed.
    program: str | None  #: Path of the program; None without one.


@dataclass(frozen=True)
class Diagnosis:
    """Tools of the machine, as ``metafab doctor --json`` prints them."""

    metafab: str  #: Version of metafab.
    python: str  #: Version of Python.
    platform: str  #: Operating system.
    cores: int  #: Cores that this process may use.
    libraries: dict[str, str]  #: Versions of the libraries.
    compiled_kernels: bool  #: Whether numba is installed, which compiles the kernels.
    meep: MeepFindings  #: Meep.
    mpi: str | None  #: First line of ``mpirun --version``; None without MPI.
    klayout: KLayoutFindings  #: KLayout.
    self_test: dict[str, bool]  #: Whether each check passes, by name.


def examine(*, rehearse: bool = False, progress: Progress = silent) -> Diagnosis:
    """Examine the machine; ``rehearse`` also runs all steps on a small lens, which compiles the first run's kernels."""
    from metafab.cell import meep
    from metafab.cell.meep.pool import own_folder

    tests = SELF_TESTS | ({"rehearsal": partial(_rehearsal_passes, progress)} if rehearse else {})
    candidates = meep.find()
    best = next((candidate for candidate in candidates if candidate.found), None)
    return Diagnosis(
        metafab=__version__,
        python=platform.python_version(),
        platform=platform.platform(),
        cores=default_workers(),
        libraries=versions(),
        compiled_kernels=find_spec("numba") is not None,
        meep=MeepFindings(
            found=best is not None,
            version=best.version if best else None,
            python=str(best.interpreter) if best else None,
            tried=candidates,
            finished_runs=own_folder(),
        ),
        mpi=_first_line("mpirun", "--version"),
        klayout=KLayoutFindings(find_spec("klayout") is not None, shutil.which("klayout")),
        self_test={name: _passes(test) for name, test in tests.items()},
    )


def _film_matches_closed_form() -> bool:
    """Compare a homogeneous film by RCWA with the Airy formula."""
    from metafab import cell
    from metafab.cell import fresnel

    film = cell.PillarCell(
        period_nm=(350.0, 350.0),
        width_nm=350.0,
        length_nm=350.0,
        height_nm=600.0,
        n_pillar=3.5 + 0.01j,
        n_substrate=(1.76, 1.76),
        n_ambient=1.0,
        wavelength_nm=800.0,
    )
    exact, _ = fresnel.film_jones(film, film.n_pillar)
    return bool(abs(cell.solve(film).t[0, 0] - exact[0, 0]) < 1e-10)


def _hdf5_writes() -> bool:
    """Write and read a small HDF5 file."""
    from metafab.core.storage import hdf5

    with TemporaryDirectory() as folder:
        path = Path(folder) / "test.h5"
        with hdf5.create(path, kind="self-test", format_version=1, inputs_sha256="") as file:
            hdf5.put(file, "x", [1.0, 2.0], units="1", description="two numbers", dims=("x",))
        with hdf5.open_kind(path, kind="self-test", format_version=1, remedy="") as file:
            return bool(file["x"][1] == 2.0)


def _rehearsal_passes(progress: Progress) -> bool:
    from metafab.rehearsal import rehearse

    return rehearse(progress).passed


SELF_TESTS: dict[str, Callable[[], bool]] = {
    "film_matches_closed_form": _film_matches_closed_form,
    "hdf5_writes": _hdf5_writes,
}


def _passes(test: Callable[[], bool]) -> bool:
    try:
        return test()
    except Exception:  # A broken installation can raise anything; the examination reports it and continues.
        return False


def _first_line(*command: str) -> str | None:
    if shutil.which(command[0]) is None:
        return None
    answer = subprocess.run(command, capture_output=True, text=True, timeout=10, check=False)
    return next(iter(answer.stdout.splitlines()), None)
