"""The library: complex t and r of every manufacturable size, each with an error bound."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metafab.cell import PillarCell, is_square
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.display import Displayed, dataset
from metafab.core.errors import InputError
from metafab.core.figures import BuildStatistics
from metafab.core.storage.files import fingerprint
from metafab.core.storage.provenance import contents_sha256, sources_sha256
from metafab.library.axes import Corner, CornerBox, Corners, corner_cell, corner_unit_cell
from metafab.library.fit.rational import RationalModel
from metafab.library.fit.size_grid import SMALLEST_SURFACE
from metafab.library.neighbours.model import Neighbours
from metafab.library.surface import SizeResponse, Surface
from metafab.spec import UnitCell
from metafab.spec.toml import LIBRARY_FORMAT

if TYPE_CHECKING:
    import xarray

#: Modules whose source and imports determine the numbers of a library. The FDTD worker is listed because it is run as a
#: program, not imported.
BUILT_BY = ("metafab.library.sweep.build", "metafab.cell.meep_worker")
#: Packages whose data files count as source: index tables.
TABLES = ("materials",)


@dataclass(frozen=True)
class BuildTime:
    """Time of a build."""

    seconds: float  #: Wall-clock time.
    solver_ms_per_point: float  #: Mean time of the solver for one size.


@dataclass(frozen=True, repr=False)
class Library(Displayed):
    """Zero-order response against pillar size, on the grid of manufacturable sizes.

    Attributes:
        unit_cell: spec that the library was built from.
        wavelength_nm: shape (n_wavelength,).
        width_nm: shape (n_width,), ascending.
        length_nm: shape (n_length,), ascending.
        t_xx: shape (n_wavelength, n_length, n_width), transmission of x polarised light.
        t_yy: shape of ``t_xx``, transmission of y polarised light.
        r_xx: shape of ``t_xx``, reflection of x polarised light.
        r_yy: shape of ``t_xx``, reflection of y polarised light.
        error: shape (n_length, n_width) or shape of ``t_xx``, error bound of each amplitude: solver and interpolation.
            NaN, like the amplitudes, at sizes outside :attr:`known`.
        inputs_sha256: fingerprint of the build's inputs.
        statistics: statistics of the build.
        model: amplitudes as continuous functions of size; None if the library was not built by a model.
        model_error: shape (n_length, n_width), error bound of the model around each size, solver included. At a solved
            size ``error`` may be smaller.
        corners: models over the axes of the sweep; None without ``sweep.axes``.
        corner: values of the axes of this library; empty at the values of the unit cell.
        neighbours: model of unlike neighbours; None if the unit cell does not ask for one, and at corners.
        time: time of the build; None for a library that was loaded.
    """

    unit_cell: UnitCell
    wavelength_nm: FloatArray
    width_nm: FloatArray
    length_nm: FloatArray
    t_xx: ComplexArray
    t_yy: ComplexArray
    r_xx: ComplexArray
    r_yy: ComplexArray
    error: FloatArray
    inputs_sha256: str = ""
    statistics: BuildStatistics = BuildStatistics()
    model: RationalModel | None = None
    model_error: FloatArray | None = None
    corners: Corners | None = None
    corner: Corner = field(default_factory=dict)
    neighbours: Neighbours | None = None
    time: BuildTime | None = None

    @property
    def known(self) -> NDArray[np.bool_]:
        """Mask of the sizes with a response (all, or the diagonal for circles), shape (n_length, n_width)."""
        return np.asarray(np.isfinite(self.error_of_sizes))

    @property
    def error_of_sizes(self) -> FloatArray:
        """``error`` at the design wavelength, shape (n_length, n_width)."""
        return np.asarray(np.broadcast_to(self.error, self.t_xx.shape)[0])

    @property
    def t(self) -> ComplexArray:
        """Both transmissions, t_xx and t_yy, at the design wavelength, shape (n_length, n_width, 2)."""
        return np.stack([self.t_xx[0], self.t_yy[0]], axis=-1)

    @property
    def is_continuous(self) -> bool:
        """Whether the library can be evaluated between its sizes (:attr:`surface`)."""
        return bool(self.known.all()) and min(self.width_nm.size, self.length_nm.size) >= SMALLEST_SURFACE

    def at(self, **axes: float) -> Library:
        """Return the library at other values of its axes: ``library.at(wavelength_nm=803.0, cd_bias_nm=2.0)``.

        At the unit cell's values that is the library itself. An axis that is not in ``unit_cell.sweep.axes``, or a
        value outside its span, raises InputError.
        """
        box = CornerBox.of(self.unit_cell)
        if box is None or self.corners is None:
            if not axes:
                return self
            got, remedy = "a library without axes", "name the axes in `[sweep.axes]` of the unit cell and build again"
            raise InputError.single("library", ", ".join(axes), "axes of the library", got, remedy)
        corner = box.completed(axes)
        if corner == box.nominal:
            return self
        exchange = box.keeps_xy_symmetry and is_square(self.unit_cell) and np.array_equal(self.width_nm, self.length_nm)
        model, error, model_error = self.corners.at(box, corner, self.width_nm, self.length_nm, exchange)
        amplitudes, is_round = model.on_grid(self.width_nm, self.length_nm), self.unit_cell.cell.is_round
        if is_round:
            amplitudes, error = (np.where(self.known, values, np.nan) for values in (amplitudes, error))
        t_xx, t_yy, r_xx, r_yy = amplitudes[:, None]
        unit_cell = corner_unit_cell(self.unit_cell, corner)
        return replace(
            self,
            unit_cell=unit_cell,
            wavelength_nm=np.array([unit_cell.illumination.wavelength_nm]),
            t_xx=t_xx,
            t_yy=t_yy,
            r_xx=r_xx,
            r_yy=r_yy,
            error=error[None],
            inputs_sha256=fingerprint(self.inputs_sha256, sorted(corner.items())),
            statistics=BuildStatistics(max_error=float(np.nanmax(error))),
            model=None if is_round else model,
            model_error=None if is_round else model_error,
            corners=None,
            corner=corner,
            neighbours=None,
        )

    def pillar(self, width_nm: float, length_nm: float) -> PillarCell:
        """Return the cell of a pillar of the given drawn size at this library's corner."""
        return corner_cell(self.unit_cell, width_nm, length_nm, self.corner)

    @cached_property
    def surface(self) -> Surface:
        """The library as continuous functions of size, built on first use.

        Fewer than four widths or lengths, and circles, raise InputError.
        """
        if not self.known.all():
            expected = "a library of all widths and lengths, which is continuous in both"
            got = f"one of {int(self.known.sum())} of {self.known.size} sizes"
            raise InputError.single("library", "sweep", expected, got, "use sizes of the grid")
        if not self.is_continuous:
            got = f"{self.width_nm.size} widths and {self.length_nm.size} lengths"
            raise InputError.single("library", "sweep", "at least 4 sizes a side", got, "sweep a range of sizes")
        error = self.error_of_sizes
        if self.model_error is not None:
            error = np.maximum(error, self.model_error)
        if self.model is None:
            return Surface.of_grid(self.width_nm, self.length_nm, self.t, error)
        target_error = self.unit_cell.sweep.target_error
        return Surface.of_model(self.width_nm, self.length_nm, self.model, error, target_error)

    def at_sizes(self, width_nm: ArrayLike, length_nm: ArrayLike) -> SizeResponse:
        """Return the stored values at sizes of the grid, at the design wavelength.

        Widths and lengths have any one shape; a size that is not in the library to within 1e-3 nm raises InputError
        (nothing is extrapolated or rounded).
        """
        column = _index(self.width_nm, np.asarray(width_nm, dtype=np.float64), "width_nm")
        row = _index(self.length_nm, np.asarray(length_nm, dtype=np.float64), "length_nm")
        if not np.all(self.known[row, column]):
            got = "a width that is not the length"
            raise InputError.single("library", "width_nm, length_nm", "diameters of circles", got)
        return SizeResponse(self.t_xx[0, row, column], self.t_yy[0, row, column], self.error_of_sizes[row, column])

    def warnings(self) -> list[str]:
        """Return sentences about sizes beyond the target error and about a model of neighbours that lowers no error."""
        target, error = self.unit_cell.sweep.target_error, self.error_of_sizes
        found = []
        if self.neighbours is not None and self.neighbours.warning is not None:
            remedy = "the model is used only where a design asks for it. Raise `neighbours.rows` in the unit cell"
            found.append(f"{self.neighbours.warning}; {remedy}")
        beyond = int(np.count_nonzero(error > target))
        if not beyond:
            return found
        row, column = np.unravel_index(int(np.nanargmax(error)), error.shape)
        known = int(self.known.sum())
        worst = self._size(f"{self.width_nm[column]:g}", f"{self.length_nm[row]:g}")
        return [
            *found,
            f"{beyond} of {known} sizes are beyond the target error {target:g}; the worst, "
            f"{worst}, is known to {error[row, column]:.2g}. "
            + (
                "A layout uses other sizes where it can; "
                if beyond < known
                else "No size is within it, so a layout uses them all; "
            )
            + "another height or period moves resonances",
        ]

    def _size(self, width: str, length: str) -> str:
        """A size in words; round pillars have a diameter."""
        return f"{width} nm in diameter" if self.unit_cell.cell.is_round else f"{width} x {length} nm"

    def key_figures(self) -> dict[str, str]:
        """Sizes, wavelength and error."""
        width, length = (f"{axis[0]:g} to {axis[-1]:g}" for axis in (self.width_nm, self.length_nm))
        return {
            "sizes": f"{int(self.known.sum())}, {self._size(width, length)}",
            "wavelength": f"{self.wavelength_nm[0]:g} nm",
            "largest error of t": f"{np.nanmax(self.error_of_sizes):.1e}",
        } | ({} if self.neighbours is None else {"neighbours": self.neighbours.summary})

    def to_xarray(self) -> xarray.Dataset:
        """Amplitudes and errors over (wavelength_nm, length_nm, width_nm); MissingToolError without xarray."""
        axes = ("wavelength_nm", "length_nm", "width_nm")
        amplitudes = {name: (axes, getattr(self, name), "") for name in ("t_xx", "t_yy", "r_xx", "r_yy")}
        error = np.broadcast_to(self.error, self.t_xx.shape)
        return dataset({**amplitudes, "error": (axes, error, "")}, {name: getattr(self, name) for name in axes})


def evaluate(library: Library, width_nm: ArrayLike, length_nm: ArrayLike, **axes: float) -> SizeResponse:
    """Evaluate a library between its sizes; to evaluate a corner often, keep ``library.at(...).surface``.

    Widths and lengths of any shapes broadcast; ``axes`` are values of the library's, such as ``wavelength_nm=803.0``. A
    size outside the sweep, or a corner outside the library's axes, raises InputError.
    """
    return library.at(**axes).surface(width_nm, length_nm)


def inputs_of(unit_cell: UnitCell) -> str:
    """Return the fingerprint of a library's inputs: the unit cell, its index tables, the file format, and the code.

    The table ``[neighbours]`` is left out: its model has a fingerprint of its own.
    """
    code, unit_cell = sources_sha256(BUILT_BY, TABLES), replace(unit_cell, neighbours=None)
    return fingerprint(unit_cell, contents_sha256(unit_cell), LIBRARY_FORMAT, code)


def _index(grid_nm: FloatArray, size_nm: FloatArray, name: str) -> NDArray[np.intp]:
    nearest = np.clip(np.searchsorted(grid_nm, size_nm - 1e-3), 0, grid_nm.size - 1)
    wrong = np.abs(grid_nm[nearest] - size_nm) > 1e-3
    if np.any(wrong):
        expected = f"sizes of its grid, {grid_nm[0]:g} to {grid_nm[-1]:g} nm"
        got = f"{np.asarray(size_nm)[wrong].flat[0]:g} nm ({int(np.count_nonzero(wrong))} sizes off the grid)"
        remedy = "use the library that the layout was made with, or build one that holds these sizes"
        raise InputError.single("library", name, expected, got, remedy)
    return np.asarray(nearest)
