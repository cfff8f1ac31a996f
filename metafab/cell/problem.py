"""From a unit-cell file to the cells that are solved, and the one call that solves them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from concurrent.futures import Executor
from functools import partial
from typing import get_args

from metafab.cell import rcwa
from metafab.cell.response import CellNumerics, CellResponse, PillarCell, Shape, SizesAt, Slice
from metafab.core.conventions import Side
from metafab.core.errors import Fault, InputError
from metafab.core.parallel.executor import SerialExecutor, stream
from metafab.core.parallel.progress import Progress, silent
from metafab.materials import refractive_index
from metafab.spec.cell import Material, UnitCell

#: Walls further from upright are no pillars; cutting them into steps would need more than are tried.
_FLATTEST_WALL_DEG = 60.0
#: Indices further apart leave nothing of double precision, whose share in an amplitude is the square of their ratio.
_WIDEST_RANGE = 1e6
#: Square root of a cell's area, in wavelengths: a quarter of a million orders leave into vacuum, too many to list.
_WIDEST_CELL = 300.0
#: Fewer cosines give no second truncation to judge the first by.
_FEWEST_ORDERS = 3


def pillar_cell(
    unit_cell: UnitCell,
    width_nm: float,
    length_nm: float,
    *,
    wavelength_nm: float | None = None,
    angle_deg: float = 0.0,
    azimuth_deg: float = 0.0,
) -> PillarCell:
    """The cell of one pillar of ``unit_cell``, materials resolved at the wavelength.

    Args:
        unit_cell: the spec.
        width_nm: pillar size along x, 0 to the period.
        length_nm: pillar size along y, 0 to the period.
        wavelength_nm: vacuum wavelength; that of the spec if not given.
        angle_deg: polar angle in the medium of incidence, 0 to < 90.
        azimuth_deg: azimuth of the plane of incidence, counter-clockwise from +x.

    Raises:
        InputError: a size or an angle is out of range, or a material is not known at the wavelength.
    """
    wavelength = unit_cell.illumination.wavelength_nm if wavelength_nm is None else wavelength_nm
    n_ambient = _isotropic_index(unit_cell.materials.ambient, wavelength, "materials.ambient")
    films, caps = (
        [(layer.height_nm, _isotropic_index(layer.material, wavelength, f"cell.{name}")) for layer in layers or ()]
        for name, layers in (("film", unit_cell.cell.film), ("cap", unit_cell.cell.cap))
    )
    cell = PillarCell(
        period_nm=unit_cell.cell.period_nm,
        width_nm=float(width_nm),
        length_nm=float(length_nm),
        height_nm=unit_cell.cell.height_nm,
        n_pillar=_isotropic_index(unit_cell.materials.pillar, wavelength, "materials.pillar"),
        n_substrate=refractive_index(unit_cell.materials.substrate, wavelength),
        n_ambient=n_ambient,
        wavelength_nm=float(wavelength),
        side=unit_cell.illumination.side,
        angle_deg=float(angle_deg),
        azimuth_deg=float(azimuth_deg),
        under=tuple(Slice(height_nm, n, n) for height_nm, n in films),
        over=tuple(Slice(height_nm, n, n_ambient) for height_nm, n in caps),
        n_substrate_z=_index_along_z(unit_cell.materials.substrate),
        sidewall_angle_deg=unit_cell.cell.sidewall_angle_deg or 90.0,
        sizes_at=unit_cell.cell.sizes_at or "middle",
        is_staggered=unit_cell.cell.is_hexagonal,
        shape="ellipse" if unit_cell.cell.shape == "circle" else unit_cell.cell.shape,
        corner_radius_nm=unit_cell.cell.corner_radius_nm or 0.0,
    )
    check(cell)
    return cell


def is_square(unit_cell: UnitCell) -> bool:
    """Whether swapping x and y swaps the two polarisations and nothing else.

    Raises:
        InputError: the substrate is not known at the wavelength.
    """
    n_x, n_y = refractive_index(unit_cell.materials.substrate, unit_cell.illumination.wavelength_nm)
    return unit_cell.has_square_lattice and n_x == n_y


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


def check(cell: PillarCell) -> None:
    """Refuse a cell that has no physical meaning.

    Raises:
        InputError: with every fault of the cell.
    """
    faults = [
        Fault("period_nm", "positive lengths", f"{period:g} nm along {axis}")
        for axis, period in zip("xy", cell.period_nm, strict=True)
        if not 0.0 < period < math.inf
    ]
    faults += _faults_of_choices(
        ("side", cell.side, get_args(Side)),
        ("sizes_at", cell.sizes_at, get_args(SizesAt)),
        ("shape", cell.shape, get_args(Shape)),
    )
    faults += _faults_of_corners(cell)
    faults.extend(
        Fault(name, f"0 to the period of {period:g} nm", f"{size:g} nm")
        for name, size, period in zip(
            ("width_nm", "length_nm"), (cell.width_nm, cell.length_nm), cell.period_nm, strict=True
        )
        if not 0.0 <= size <= period and 0.0 < period < math.inf
    )
    if not _FLATTEST_WALL_DEG <= cell.sidewall_angle_deg <= 180.0 - _FLATTEST_WALL_DEG:
        flattest = _FLATTEST_WALL_DEG
        faults.append(
            Fault("sidewall_angle_deg", f"{flattest:g} to {180.0 - flattest:g}", f"{cell.sidewall_angle_deg:g}")
        )
    elif not faults:
        faults = _faults_of_ends(cell)
    if not 0.0 <= cell.angle_deg < 90.0:
        faults.append(Fault("angle_deg", "0 to below 90", f"{cell.angle_deg:g}"))
    if not math.isfinite(cell.azimuth_deg):
        faults.append(Fault("azimuth_deg", "a finite angle", f"{cell.azimuth_deg:g}"))
    if not 0.0 < cell.wavelength_nm < float("inf"):
        faults.append(Fault("wavelength_nm", "a positive length", f"{cell.wavelength_nm:g}"))
    if not 0.0 <= cell.height_nm < float("inf"):
        faults.append(Fault("height_nm", "a length from 0", f"{cell.height_nm:g}"))
    slices = {f"{side}[{i}]": each for side in ("under", "over") for i, each in enumerate(getattr(cell, side))}
    faults.extend(
        Fault(f"{name}.height_nm", "a length from 0", f"{each.height_nm:g}")
        for name, each in slices.items()
        if not 0.0 <= each.height_nm < float("inf")
    )
    faults.extend(
        Fault(f"{name}.{axis}_nm", f"0 to the period of {period:g} nm", f"{size:g} nm")
        for name, each in slices.items()
        for axis, size, period in zip(("width", "length"), (each.width_nm, each.length_nm), cell.period_nm, strict=True)
        if size is not None and not 0.0 <= size <= period
    )
    indices: dict[str, tuple[complex, ...]] = {f"{name}.n": (s.n_inside, s.n_around) for name, s in slices.items()}
    indices |= {"n_pillar": (cell.n_pillar,), "n_substrate": cell.n_substrate, "n_ambient": (cell.n_ambient,)}
    if cell.n_substrate_z is not None:
        indices["n_substrate_z"] = (cell.n_substrate_z,)
    for name, values in indices.items():
        faults.extend(
            Fault(name, "a finite index with real part > 0 and imaginary part >= 0", f"{n}")
            for n in map(complex, values)
            if not (0.0 <= n.imag < float("inf") and 0.0 < n.real < float("inf"))
        )
    sizes = [abs(n) for values in indices.values() for n in map(complex, values)]
    if not faults and max(sizes) > _WIDEST_RANGE * min(sizes):
        expected = "indices of which none is more than a million to one of another"
        faults.append(Fault("n_pillar, n_substrate, n_ambient", expected, f"{min(sizes):g} to {max(sizes):g}"))
    if not faults:
        faults = _faults_of_width(cell)
    if faults:
        raise InputError("cell", faults)


def _faults_of_corners(cell: PillarCell) -> list[Fault]:
    """Corners that cannot be rounded, and crosses that a cell cannot hold."""
    faults = []
    if not 0.0 <= cell.corner_radius_nm < math.inf:
        faults.append(Fault("corner_radius_nm", "a length from 0", f"{cell.corner_radius_nm:g} nm"))
    elif cell.corner_radius_nm and 0.0 < min(cell.width_nm, cell.length_nm) < 2.0 * cell.corner_radius_nm:
        most = 0.5 * min(cell.width_nm, cell.length_nm)
        got = f"{cell.corner_radius_nm:g} nm"
        faults.append(Fault("corner_radius_nm", f"at most half the shorter side, {most:g} nm", got))
    elif cell.corner_radius_nm and cell.shape != "rectangle":
        faults.append(Fault("corner_radius_nm", f"0 for the shape {cell.shape}", f"{cell.corner_radius_nm:g} nm"))
    if cell.shape == "cross" and max(cell.width_nm, cell.length_nm) > min(cell.period_nm):
        span = max(cell.width_nm, cell.length_nm)
        faults.append(Fault("width_nm, length_nm", f"a cross within {min(cell.period_nm):g} nm", f"{span:g} nm"))
    return faults


def check_numerics(numerics: CellNumerics) -> None:
    """Refuse numerics that no solver can follow.

    Raises:
        InputError: with every fault of the numerics.
    """
    faults = _faults_of_choices(
        ("solver", numerics.solver, ("rcwa", "meep")), ("formulation", numerics.formulation, ("adaptive", "fourier"))
    )
    if not 0.0 < numerics.target_error < 1.0:
        faults.append(Fault("target_error", "above 0 and below 1", f"{numerics.target_error:g}"))
    if not numerics.max_orders >= _FEWEST_ORDERS:
        faults.append(Fault("max_orders", f"{_FEWEST_ORDERS} or more", f"{numerics.max_orders}"))
    if faults:
        raise InputError("numerics", faults)


def _faults_of_choices(*choices: tuple[str, str, tuple[str, ...]]) -> list[Fault]:
    """Names, got and known: those of which nothing is known."""
    return [Fault(name, " or ".join(known), repr(got)) for name, got, known in choices if got not in known]


def _faults_of_width(cell: PillarCell) -> list[Fault]:
    """A cell of so many square wavelengths that the orders that leave cannot be counted, let alone solved for."""
    x_nm, y_nm = cell.period_nm
    if x_nm * y_nm <= (_WIDEST_CELL * cell.wavelength_nm) ** 2:
        return []
    return [
        Fault(
            "period_nm",
            f"a cell of at most {_WIDEST_CELL:g} by {_WIDEST_CELL:g} wavelengths",
            f"{x_nm:g} by {y_nm:g} nm at a wavelength of {cell.wavelength_nm:g} nm",
        )
    ]


def _faults_of_ends(cell: PillarCell) -> list[Fault]:
    """Ends of a sloped pillar that have vanished or touch their neighbours."""
    return [
        Fault(
            f"{axis}_nm",
            f"sizes of 0 to the period of {period:g} nm from the pillar's bottom to its top",
            f"{size:g} nm at the {end} with a sidewall_angle_deg of {cell.sidewall_angle_deg:g}",
            "sweep sizes further from 0 and from the period, or steepen the wall",
        )
        for end, share in (("bottom", 0.0), ("top", 1.0))
        for axis, size, period in zip(("width", "length"), cell.sizes_nm(share), cell.period_nm, strict=True)
        if cell.is_sloped and not 0.0 <= size <= period
    ]


def solve(cell: PillarCell, numerics: CellNumerics = CellNumerics()) -> CellResponse:  # noqa: B008 (frozen)
    """Jones matrices of one cell by the solver that ``numerics`` names.

    Raises:
        InputError: the cell has no physical meaning, the numerics ask for nothing known, or the cell lies outside what
            the solver treats.
        MissingToolError: Meep is asked for and not installed.
        SolverError: the solver failed.
    """
    check(cell)
    check_numerics(numerics)
    if cell.is_staggered:
        _check_staggered(cell, numerics)
    if numerics.solver == "meep":
        if cell.under or cell.over:
            raise InputError.single("cell", "under, over", "empty for meep", "layers", "solve with rcwa")
        if cell.is_sloped:
            angle = f"{cell.sidewall_angle_deg:g}"
            raise InputError.single("cell", "sidewall_angle_deg", "90 for meep", angle, "solve with rcwa")
        if cell.is_shaped:
            raise InputError.single("cell", "shape, corner_radius_nm", "a rectangle for meep", cell.shape, "use rcwa")
        if cell.is_birefringent:
            index = f"{cell.n_substrate_z}"
            raise InputError.single("cell", "n_substrate_z", "not given for meep", index, "solve with rcwa")
        from metafab.cell import meep

        return meep.solve(cell, numerics)
    return rcwa.solve(cell, numerics)


def _check_staggered(cell: PillarCell, numerics: CellNumerics) -> None:
    """What is not treated of a hexagonal lattice."""
    untreated = {
        "solver": numerics.solver != "rcwa",
        "angle_deg": cell.angle_deg != 0.0,
        "under, over": bool(cell.under or cell.over),
        "sidewall_angle_deg": cell.is_sloped,
        "n_substrate_z": cell.is_birefringent,
        "shape, corner_radius_nm": cell.is_shaped,
    }
    faults = [
        Fault(name, "rcwa, upright pillars without layers and light along z on a hexagonal lattice", "another")
        for name, found in untreated.items()
        if found
    ]
    if faults:
        raise InputError("cell", faults)


def solve_many(
    cells: Iterable[PillarCell],
    numerics: CellNumerics = CellNumerics(),  # noqa: B008 (frozen)
    executor: Executor | None = None,
    progress: Progress = silent,
    *,
    batch: int = 16,
) -> Iterator[CellResponse]:
    """Solve many cells, in batches over an executor; responses come as they finish, each with its cell.

    Args:
        cells: what to solve.
        numerics: the same for all.
        executor: processes or a cluster; this process if not given.
        progress: called after every batch.
        batch: cells a call hands to one worker.

    Raises:
        InputError, MissingToolError, SolverError: as :func:`solve`.
    """
    todo = list(cells)
    batches = [todo[start : start + batch] for start in range(0, len(todo), batch)]
    done = 0
    for _, responses in stream(executor or SerialExecutor(), partial(_solve_batch, numerics=numerics), batches):
        done += len(responses)
        progress("cells", done, len(todo))
        yield from responses


def _solve_batch(cells: list[PillarCell], numerics: CellNumerics) -> list[CellResponse]:
    return [solve(cell, numerics) for cell in cells]
