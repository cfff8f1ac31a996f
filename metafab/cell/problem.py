"""Cells of a unit-cell spec, and the functions that solve one cell or many."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import replace
from functools import partial

from metafab.cell import curved, rcwa
from metafab.cell.pillar import PillarCell, Slice
from metafab.cell.rcwa.jones import ZeroOrder
from metafab.cell.response import CellNumerics, CellResponse
from metafab.cell.validation import check, check_numerics
from metafab.core.arguments import require_types
from metafab.core.errors import Fault, InputError
from metafab.core.parallel.executor import default_workers, open_executor, stream
from metafab.core.parallel.processes import can_fork
from metafab.core.parallel.progress import Progress, silent
from metafab.materials import refractive_index
from metafab.spec.cell import Material, UnitCell


def pillar_cell(
    unit_cell: UnitCell,
    width_nm: float,
    length_nm: float,
    *,
    wavelength_nm: float | None = None,
    angle_deg: float = 0.0,
    azimuth_deg: float = 0.0,
) -> PillarCell:
    """Return the cell of one pillar of ``unit_cell``, with the indices at ``wavelength_nm`` (by default the spec's).

    Width (along x) and length (along y) are 0 to the period. ``angle_deg`` is the polar angle in the medium of
    incidence, 0 to < 90; ``azimuth_deg`` that of the plane of incidence, counter-clockwise from +x. InputError if one
    is out of range, or a material is not known at the wavelength. Two sizes make an ellipse of a circle.
    """
    spec, materials = unit_cell.cell, unit_cell.materials
    wavelength = unit_cell.illumination.wavelength_nm if wavelength_nm is None else wavelength_nm
    n_ambient = _isotropic_index(materials.ambient, wavelength, "materials.ambient")
    films = [(each.height_nm, _isotropic_index(each.material, wavelength, "cell.film")) for each in spec.film or ()]
    caps = [(each.height_nm, _isotropic_index(each.material, wavelength, "cell.cap")) for each in spec.cap or ()]
    cell = PillarCell(
        period_nm=spec.period_nm,
        width_nm=float(width_nm),
        length_nm=float(length_nm),
        height_nm=spec.height_nm,
        n_pillar=_isotropic_index(materials.pillar, wavelength, "materials.pillar"),
        n_substrate=refractive_index(materials.substrate, wavelength),
        n_ambient=n_ambient,
        wavelength_nm=float(wavelength),
        side=unit_cell.illumination.side,
        angle_deg=float(angle_deg),
        azimuth_deg=float(azimuth_deg),
        under=tuple(Slice(height_nm, n, n) for height_nm, n in films),
        over=tuple(Slice(height_nm, n, n_ambient) for height_nm, n in caps),
        n_substrate_z=_index_along_z(materials.substrate),
        sidewall_angle_deg=spec.sidewall_angle_deg or 90.0,
        sizes_at=spec.sizes_at or "middle",
        is_staggered=spec.is_hexagonal,
        shape="ellipse" if spec.shape == "circle" or (spec.shape == "ring" and not width_nm) else spec.shape,
        corner_radius_nm=spec.corner_radius_nm or 0.0,
        hole_nm=spec.hole_nm(width_nm) if width_nm else 0.0,
    )
    check(cell)
    return cell


def is_square(unit_cell: UnitCell) -> bool:
    """Whether swapping x and y swaps the polarisations and nothing else; InputError if the substrate is not known."""
    n_x, n_y = refractive_index(unit_cell.materials.substrate, unit_cell.illumination.wavelength_nm)
    return unit_cell.has_square_lattice and n_x == n_y


def solve(
    cell: PillarCell,
    numerics: CellNumerics = CellNumerics(),  # noqa: B008 (frozen)
    known: dict[tuple[int, int], ZeroOrder] | None = None,
) -> CellResponse:
    """Solve one cell for its Jones matrices with the solver that ``numerics`` names.

    ``known`` is a cache of this cell's solutions by RCWA or elements, (cosines or polynomial order, steps) -> solution,
    read and extended: for calls of several targets.

    Raises:
        InputError: an argument is of another type, the cell is unphysical, the numerics are out of range, or the solver
            does not treat the cell.
        MissingToolError: Meep is asked for and not installed.
        SolverError: the solver failed.
    """
    if isinstance(cell, UnitCell):
        remedy = "`pillar_cell` makes one of a unit cell and two sizes"
        raise InputError.single("cell", "cell", "a PillarCell", "UnitCell", remedy)
    require_types("cell", cell=(cell, PillarCell), numerics=(numerics, CellNumerics))
    check(cell)
    check_numerics(numerics)
    faults = curved.untreated(cell)
    if numerics.solver == "elements" and faults:
        raise InputError("cell", faults)
    if not faults and numerics.solver != "meep" and numerics.formulation == "adaptive":
        return curved.solve(cell, numerics, known)
    if cell.is_staggered or (cell.shape == "ring" and numerics.solver != "meep"):
        _refuse_for_rcwa(cell, numerics)
    if numerics.solver == "rcwa":
        return rcwa.solve(cell, numerics, known)
    from metafab.cell import meep

    return meep.solve(cell, numerics)


def _refuse_for_rcwa(cell: PillarCell, numerics: CellNumerics) -> None:
    """Refuse a ring, or a cell of a hexagonal lattice, that RCWA does not treat."""
    faults = cell.untreated("a hexagonal lattice", treated=("is_staggered", "shape, corner_radius_nm"))
    if cell.is_shaped:
        # Curved outlines have the elements alone.
        remedy = "rings, and round pillars of a hexagonal lattice, are solved by spectral elements alone"
        faults = [replace(fault, remedy=remedy) for fault in curved.untreated(cell)]
        if numerics.formulation != "adaptive":
            expected = "adaptive for rings, and for ellipses in a hexagonal lattice"
            faults.append(Fault("formulation", expected, numerics.formulation))
    if numerics.solver != "rcwa":
        faults.append(Fault("solver", "rcwa for a hexagonal lattice", numerics.solver))
    if faults:
        raise InputError("cell", faults)


def solve_many(
    cells: Iterable[PillarCell],
    numerics: CellNumerics = CellNumerics(),  # noqa: B008 (frozen)
    executor: Executor | None = None,
    progress: Progress = silent,
    *,
    batch: int = 4,
) -> Iterator[CellResponse]:
    """Solve cells in batches of ``batch`` over an executor; yield one response for each cell, as they finish.

    Equal cells, and cells that are equal once x and y are exchanged, are solved once. ``executor`` is by default
    processes on all cores for more than one batch where they can be forked, else this process. ``progress`` is called
    after every batch. Errors as :func:`solve`.
    """
    alike: dict[PillarCell, list[PillarCell]] = {}
    for cell in cells:
        image = cell.exchanged()
        alike.setdefault(image if image is not None and image in alike else cell, []).append(cell)
    distinct, total, done = list(alike), sum(map(len, alike.values())), 0
    batches = [distinct[start : start + batch] for start in range(0, len(distinct), batch)]
    with ExitStack() as opened:
        if executor is None:
            workers = default_workers() if len(batches) > 1 and can_fork() else 1
            executor = opened.enter_context(open_executor(workers))
        for _, responses in stream(executor, partial(_solve_batch, numerics=numerics), batches):
            done += sum(len(alike[response.cell]) for response in responses)
            progress("cells", done, total)
            for response in responses:
                yield from (
                    response if cell == response.cell else response.exchanged() for cell in alike[response.cell]
                )


def _solve_batch(cells: list[PillarCell], numerics: CellNumerics) -> list[CellResponse]:
    return [solve(cell, numerics) for cell in cells]


def _isotropic_index(material: Material, wavelength_nm: float, field: str) -> complex:
    n_x, n_y = refractive_index(material, wavelength_nm)
    if n_x != n_y:
        got = f"{material.record or 'an index for y'}: {n_x:.6g} for x, {n_y:.6g} for y polarised light"
        raise InputError.single("cell", field, "an isotropic material; only the substrate may be birefringent", got)
    return n_x


def _index_along_z(substrate: Material) -> complex | None:
    if substrate.n_z is None:
        return None
    return complex(substrate.n_z, substrate.k if substrate.k_z is None else substrate.k_z)
