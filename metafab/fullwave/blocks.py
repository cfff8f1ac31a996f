"""Supercells of a file: ``BLOCKS.json`` in, transmitted orders by one of four solvers out.

- ``model``  the library's model of coupled modes (:mod:`metafab.library.neighbours`)
- ``rcwa``   modes of the layer in spectral elements, plane waves in the half spaces (:mod:`metafab.cell.elements`)
- ``meep``   FDTD on several grids
- ``lone``   the local-period approximation: each pillar as in a lattice of equal pillars
"""

from __future__ import annotations

import dataclasses
import json
import math
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import numpy as np
from pydantic import Field, model_validator

from metafab.cell import solve as solve_cell
from metafab.cell.elements.solve import ElementNumerics, require_treated, supercell_orders
from metafab.cell.meep import Pool
from metafab.cell.meep.supercell import SupercellSettings, memory_bytes, refined_orders
from metafab.cell.supercell import Supercell, SupercellOrders
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.errors import Fault, InputError, SolverError, noted
from metafab.core.parallel.executor import SerialExecutor, stream
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.files import file_sha256, fingerprint, unique_keys
from metafab.core.storage.limits import beyond, limit
from metafab.core.storage.provenance import sources_sha256
from metafab.fullwave.record import record_orders, recorded_orders
from metafab.fullwave.written import site_cell
from metafab.library import Library
from metafab.library.neighbours import has_joint_effect, solve_supercell
from metafab.library.sweep.checkpoint import Checkpoint
from metafab.spec.fields import NonNegative, spec
from metafab.spec.toml import validate

Solver: TypeAlias = Literal["model", "rcwa", "meep", "lone"]
_Numbered: TypeAlias = tuple[int, Supercell]  # a block and its place in the file

#: Bound on the error of the local-period approximation over the rms step of t from site to site. On seven silicon rows
#: (lens-like, random, nearly equal) the share was 0.16 to 0.47, on nine rows of 2 to 13 random sizes up to 0.50.
_PER_STEP = 0.6
#: Smallest size of a pillar over the wavelength; a smaller one is probably in micrometres.
_LEAST_SIZE = 1e-3
#: Largest accepted file of supercells, MB, unless a limit ``memory_mb`` is stated, for example by a design.
_LARGEST_MB = 4.0
#: Largest accepted memory of Meep, MB, unless that limit is stated; `metafab patch` has the same.
_MOST_MEEP_MB = 8000.0

_Sizes = Annotated[list[Annotated[list[NonNegative], Field(min_length=1)]], Field(min_length=1)]


@spec()
class Block:
    """Pillars of one supercell, rows from the lowest y, columns from the lowest x; sizes of 0 mark empty sites."""

    width_nm: _Sizes  #: Size along x of each pillar.
    length_nm: _Sizes  #: Size along y of each pillar.

    @model_validator(mode="after")
    def _one_shape(self) -> Block:
        lengths = [[len(row) for row in sizes] for sizes in (self.width_nm, self.length_nm)]
        if lengths[0] != lengths[1] or len(set(lengths[0])) > 1:
            got = " and ".join(f"rows of {_span(each)} sizes ({len(each)})" for each in lengths)
            expected = "`width_nm` and `length_nm` of equally many rows, all of one length"
            raise ValueError(f"expected {expected}, got {got}; give 0 where no pillar stands")
        return self

    @property
    def size_nm(self) -> FloatArray:
        """Sizes of the pillars, shape (n_y, n_x, 2)."""
        return np.stack([np.array(self.width_nm, float), np.array(self.length_nm, float)], axis=-1)


def _span(counts: list[int]) -> str:
    low, high = min(counts), max(counts)
    return str(low) if low == high else f"{low} to {high}"


@spec()
class Blocks:
    """Content of ``BLOCKS.json``."""

    blocks: Annotated[list[Block], Field(min_length=1)]  #: One supercell each.


@dataclasses.dataclass(frozen=True)
class BlockNumerics:
    """Numerics of the full-wave solvers."""

    rcwa: ElementNumerics = dataclasses.field(default_factory=ElementNumerics)  #: Target error and resolutions.
    pixels_per_period: tuple[int, ...] = (16, 24)  #: Grids of Meep, two or more.


def read_blocks(
    path: Path, library: Library, solver: Solver = "rcwa", numerics: BlockNumerics = BlockNumerics()
) -> list[Supercell]:
    """Read supercells of the library's unit cell.

    InputError if the file is missing or holds faults (all of them are reported), if supercells of this unit cell cannot
    be solved, or if ``solver`` does not treat one: sizes beyond the library's sweep (``model``, ``lone``), too many
    functions or pillars that nearly touch (``rcwa``), too much memory (``meep``). Nothing is solved before.
    """
    try:
        most_mb = limit("memory_mb", _LARGEST_MB)
        if (size := path.stat().st_size) > 1e6 * most_mb:
            raise beyond(str(path), "file", "memory_mb", f"at most {most_mb:g} MB", f"{size} bytes", by_design=False)
        table = json.loads(path.read_text(encoding="utf-8-sig"), object_pairs_hook=unique_keys)
    except FileNotFoundError:
        raise InputError.single(str(path), "file", "a JSON file", "no file at that path", "check the path") from None
    except (OSError, ValueError, RecursionError) as error:
        got = f"an unreadable file ({error})"
        raise InputError.single(str(path), "file", 'a JSON file {"blocks": [...]}', got, "correct it") from error
    cell, faults = site_cell(library), list[Fault]()
    blocks = validate(Blocks, table, str(path)).blocks
    for number, block in enumerate(blocks):
        faults += _size_faults(library, f"blocks[{number}]", block.size_nm, solver)
    if not faults:
        supercells = [Supercell(cell, block.size_nm) for block in blocks]
        faults += [each for k, one in enumerate(supercells) for each in _untreated(one, k, solver, numerics)]
    if faults:
        raise InputError(str(path), faults)
    return supercells


def _size_faults(library: Library, block: str, size_nm: FloatArray, solver: Solver) -> Iterator[Fault]:
    """Faults of the sizes of a block, shape (n_y, n_x, 2): width and length, both 0 for an empty site."""
    cell = library.unit_cell.cell
    least = _LEAST_SIZE * library.unit_cell.illumination.wavelength_nm
    for axis, name in enumerate(("width_nm", "length_nm")):
        largest, period = float(size_nm[..., axis].max()), cell.period_nm[axis]
        smallest = float(size_nm[..., axis].min(where=size_nm[..., axis] > 0.0, initial=math.inf))
        if smallest < least:
            expected = f"0, or at least {least:g} nm, a thousandth of the wavelength"
            yield Fault(f"{block}.{name}", expected, f"{smallest:g} nm", "is it in nanometres?")
        elif largest > period:
            expected, remedy = f"at most the period of {period:g} nm", "make the pillar smaller"
            yield Fault(f"{block}.{name}", expected, f"{largest:g} nm", remedy)
        elif solver in {"model", "lone"}:
            yield from _beyond_sweep(library, f"{block}.{name}", size_nm[..., axis], axis, solver)
    if np.any((size_nm[..., 0] == 0.0) != (size_nm[..., 1] == 0.0)):
        yield Fault(block, "width and length both 0, or both above", "one of them 0")
    if cell.is_round and np.any(size_nm[..., 0] != size_nm[..., 1]):
        yield Fault(block, "`length_nm` equal to `width_nm` for circles", "other lengths")


def _untreated(supercell: Supercell, number: int, solver: Solver, numerics: BlockNumerics) -> Sequence[Fault]:
    """Faults of block ``number`` if a full-wave solver does not treat it, or takes more memory than it may."""
    if solver == "rcwa":
        try:
            require_treated(supercell, numerics.rcwa)
        except InputError as refused:
            return [dataclasses.replace(fault, field=f"blocks[{number}]") for fault in refused.faults]
    elif solver == "meep":
        pixels, most_mb = max(numerics.pixels_per_period), limit("memory_mb", _MOST_MEEP_MB)
        taken_mb = 1e-6 * memory_bytes(supercell, SupercellSettings(pixels))
        if taken_mb > most_mb:
            n_y, n_x = supercell.shape
            got = f"about {taken_mb:.0f} MB for {n_x} x {n_y} pillars at {pixels} pixels a period"
            remedy = "ask for fewer pixels, use the solver model, or raise `--limit memory_mb=N`"
            return [Fault(f"blocks[{number}]", f"at most {most_mb:g} MB of memory for Meep", got, remedy)]
    return []


def _beyond_sweep(library: Library, field: str, size_nm: FloatArray, axis: int, solver: Solver) -> list[Fault]:
    """Fault of sizes along an axis (0 width, 1 length) that the library does not hold; ``lone`` has empty sites."""
    grid = library.length_nm if axis else library.width_nm
    stands = size_nm > 0.0
    beyond_sweep = stands & ((size_nm < grid[0]) | (size_nm > grid[-1]))
    expected = f"{grid[0]:g} to {grid[-1]:g} nm, the library's sweep"
    if beyond_sweep.any():
        return [Fault(field, expected, f"{size_nm[beyond_sweep][0]:.10g} nm", "use the solver rcwa or meep")]
    if solver == "model" and not stands.all():
        return [Fault(field, expected, "an empty site", "use the solver rcwa, meep or lone")]
    return []


def inputs_of_answers(library: Path, solver: Solver, numerics: BlockNumerics) -> str:
    """Fingerprint of all that the answer for a block depends on besides its pillars; ``library`` is the file."""
    code = sources_sha256(("metafab.fullwave.blocks",), ())
    return fingerprint(file_sha256(library), solver, numerics, code)


def solve_blocks(
    supercells: Sequence[Supercell],
    library: Library,
    solver: Solver,
    numerics: BlockNumerics = BlockNumerics(),
    *,
    record: Checkpoint | None = None,
    executor: Executor | None = None,
    pool: Pool | None = None,
    progress: Progress = silent,
) -> list[SupercellOrders]:
    """Solve supercells for both incident polarisations.

    Args:
        supercells: pillars in the library's unit cell.
        library: library for ``lone`` and ``model``.
        numerics: numerics of ``rcwa`` and ``meep``.
        record: holds solved blocks, which are not solved again; takes each other one as it is solved.
        executor: solves blocks by ``rcwa`` in parallel, and by ``model`` those whose joint effect is solved; by default
            this process.
        pool: workers of Meep; by default one that lives as long as this process.

    Raises:
        InputError: the solver does not treat a supercell, or the library has no model.
        MissingToolError: Meep is asked for but not installed.
        SolverError: the solver failed on the supercells that the message names; all others are solved before.
    """
    solve: dict[Solver, Callable[[Supercell], SupercellOrders]] = {
        "lone": partial(lone_orders, library=library),
        "rcwa": partial(supercell_orders, numerics=numerics.rcwa),
        "meep": partial(refined_orders, pixels_per_period=numerics.pixels_per_period, pool=pool, progress=progress),
        "model": partial(solve_supercell, library),
    }
    record = record or Checkpoint(None, "")
    found = recorded_orders(record, supercells)
    here: list[_Numbered] = []
    sent: list[_Numbered] = []
    for number, supercell in enumerate(supercells):
        if number in found:
            continue
        # Chains and look-ups take milliseconds, less than a process takes to start; Meep has workers of its own.
        goes_out = solver == "rcwa" or (solver == "model" and has_joint_effect(supercell))
        (sent if executor is not None and goes_out else here).append((number, supercell))
    if solver == "model" and sent:
        _ = library.surface  # made once here, not by each worker
    progress("supercells", len(found), len(supercells))
    failures: dict[int, Exception] = {}
    for calls, some in ((SerialExecutor(), here), (executor or SerialExecutor(), sent)):
        # In this process the next block begins when the last one is recorded.
        ahead = 1 if isinstance(calls, SerialExecutor) else len(some)
        for (number, _), answer in stream(calls, partial(_attempt, solve[solver]), some, ahead=ahead):
            if isinstance(answer, SupercellOrders):
                found[number] = answer
                record_orders(record, answer)
            else:
                failures[number] = answer
            progress("supercells", len(found) + len(failures), len(supercells))
    if failures:
        raise SolverError("\n".join(f"blocks[{number}]: {failures[number]}" for number in sorted(failures)))
    return [found[number] for number in range(len(supercells))]


def _attempt(solve: Callable[[Supercell], SupercellOrders], numbered: _Numbered) -> SupercellOrders | Exception:
    """Orders of a block, or the error of its solver, which need not end the solution of others."""
    number, supercell = numbered
    try:
        with noted(f"blocks[{number}]"):
            return solve(supercell)
    except (SolverError, np.linalg.LinAlgError) as error:
        return error


def lone_orders(supercell: Supercell, library: Library) -> SupercellOrders:
    """Transmitted orders by the local-period approximation, with the values of a library.

    The error is the library's plus, for unlike neighbours, :data:`_PER_STEP` times the rms step of t from site to site.
    InputError if a size lies outside the library's sweep.
    """
    start = time.perf_counter()
    pillar = np.all(supercell.size_nm > 0.0, axis=-1)
    t, error = np.zeros((*supercell.shape, 2), dtype=np.complex128), 0.0
    if pillar.any():
        stored = (library.surface if library.is_continuous else library.at_sizes)(*supercell.size_nm[pillar].T)
        t[pillar], error = np.stack([stored.t_xx, stored.t_yy], axis=-1), float(np.max(stored.error))
    if not pillar.all():
        t[~pillar] = np.diagonal(solve_cell(supercell.cell).t)
    order = supercell.propagating_orders("x")
    jones = np.zeros((len(order), 2, 2), dtype=np.complex128)
    for axis in range(2):
        jones[:, axis, axis] = supercell.local_period(order, t[..., axis])
    scale = float(np.sqrt(np.mean(np.abs(t) ** 2)))
    total = error / scale + _PER_STEP * _roughness(t) / scale
    return SupercellOrders(supercell, order, jones, total, time.perf_counter() - start)


def _roughness(t: ComplexArray) -> float:
    """Rms step of ``t``, shape (n_y, n_x, 2), between adjacent sites of the period."""
    steps = [np.abs(t - np.roll(t, 1, axis)) ** 2 for axis in (0, 1)]
    return float(np.sqrt(np.mean(steps[0] + steps[1])))
