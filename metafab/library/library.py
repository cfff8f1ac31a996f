"""The phase library: complex t and r of every manufacturable size, each with its error."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metafab.cell import PillarCell
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.errors import InputError
from metafab.core.storage.files import fingerprint
from metafab.core.storage.provenance import contents_sha256, sources_sha256
from metafab.library.axes import Corner, corner_cell
from metafab.library.fit.models import SizeModel
from metafab.spec import UnitCell, canonical_toml
from metafab.spec.embedded import LIBRARY_FORMAT

if TYPE_CHECKING:
    from metafab.library.corners import Corners
    from metafab.library.surface import Surface

#: Fewest widths and lengths that a surface goes through.
SMALLEST_SURFACE = 4
#: What a library's numbers come from, with all that it imports; the FDTD program is started, not imported.
BUILT_BY = ("metafab.library.sweep.build", "metafab.cell.meep_worker")
#: Index tables, which are read, not imported.
TABLES = ("materials",)


@dataclass(frozen=True)
class SizeResponse:
    """Library values at some sizes.

    Attributes:
        t_xx: shape of the sizes, zero-order transmission of x polarised light.
        t_yy: the same for y.
        error: bound on the absolute error of either.
    """

    t_xx: ComplexArray
    t_yy: ComplexArray
    error: FloatArray


@dataclass(frozen=True)
class Library:
    """Zero-order response against pillar size, on the grid of manufacturable sizes.

    Attributes:
        unit_cell: the spec that it was built from.
        wavelength_nm: shape (n_wavelength,).
        width_nm: shape (n_width,), ascending.
        length_nm: shape (n_length,), ascending.
        t_xx: shape (n_wavelength, n_length, n_width); likewise ``t_yy``, ``r_xx``, ``r_yy``.
        error: shape (n_length, n_width) or with a leading wavelength axis; solver and interpolation together. NaN, like
            the amplitudes, at sizes that are not made (:attr:`known`).
        inputs_sha256: fingerprint of what it was built from.
        details: figures of the build (points solved, held-out error, ...), the same wherever it ran.
        spent: what the build took (seconds, solver_ms_per_point); empty for a library that was loaded.
        model: the same amplitudes as continuous functions; None for a library that was not built by a model.
        model_error: shape (n_length, n_width), error of the model around each size, solver's included; ``error``
            is smaller where a size was solved and its neighbourhood is not as well known.
        corners: what is known away from the unit cell's own wavelength, height, ...; None without ``sweep.axes``.
        corner: the values of the axes that this library is for; empty for the unit cell's own.
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
    details: dict[str, float | str] = field(default_factory=dict)
    model: SizeModel | None = None
    model_error: FloatArray | None = None
    corners: Corners | None = None
    corner: Corner = field(default_factory=dict)
    spent: dict[str, float] = field(default_factory=dict)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Which sizes are made, shape (n_length, n_width): all, or of circles those as wide as long."""
        return np.asarray(np.isfinite(self.error_of_sizes))

    @property
    def error_of_sizes(self) -> FloatArray:
        """``error`` at the design wavelength, shape (n_length, n_width)."""
        return np.asarray(np.broadcast_to(self.error, self.t_xx.shape)[0])

    @property
    def is_continuous(self) -> bool:
        """Whether it can be evaluated between its sizes (:attr:`surface`)."""
        return bool(self.known.all()) and min(self.width_nm.size, self.length_nm.size) >= SMALLEST_SURFACE

    def at(self, **axes: float) -> Library:
        """The same sizes at other values of the library's axes: ``library.at(wavelength_nm=803.0, cd_bias_nm=2.0)``.

        Returns:
            A library of that corner, with the errors that it has there; the library itself if all values are the
            unit cell's own.

        Raises:
            InputError: an axis is not in ``unit_cell.sweep.axes``, or a value lies outside its span.
        """
        from metafab.library.corners import library_at

        return library_at(self, axes)

    def pillar(self, width_nm: float, length_nm: float) -> PillarCell:
        """The cell that the library's values for a size are the response of."""
        return corner_cell(self.unit_cell, width_nm, length_nm, self.corner)

    @cached_property
    def surface(self) -> Surface:
        """The library as continuous functions of size, built at the first use."""
        from metafab.library.surface import Surface

        return Surface.of(self)

    def at_sizes(self, width_nm: ArrayLike, length_nm: ArrayLike) -> SizeResponse:
        """Stored values at sizes of the grid, exactly; design wavelength.

        Args:
            width_nm: any shape; each must be a size of the library to within 1e-3 nm.
            length_nm: the same shape.

        Raises:
            InputError: a size is not in the library (nothing is extrapolated or rounded).
        """
        column = _index(self.width_nm, np.asarray(width_nm, dtype=np.float64), "width_nm")
        row = _index(self.length_nm, np.asarray(length_nm, dtype=np.float64), "length_nm")
        if not np.all(self.known[row, column]):
            got = "a width that is not the length"
            raise InputError.single("library", "width_nm, length_nm", "diameters of circles", got)
        return SizeResponse(self.t_xx[0, row, column], self.t_yy[0, row, column], self.error_of_sizes[row, column])


def inputs_of(unit_cell: UnitCell) -> str:
    """Fingerprint of all that a library depends on: the unit cell, its index tables, the format, and the code."""
    code = sources_sha256(BUILT_BY, TABLES)
    return fingerprint(canonical_toml(unit_cell), contents_sha256(unit_cell), LIBRARY_FORMAT, code)


def _index(grid_nm: FloatArray, size_nm: FloatArray, name: str) -> np.ndarray:
    nearest = np.clip(np.searchsorted(grid_nm, size_nm - 1e-3), 0, grid_nm.size - 1)
    wrong = np.abs(grid_nm[nearest] - size_nm) > 1e-3
    if np.any(wrong):
        raise InputError.single(
            "library",
            name,
            f"sizes of its grid, {grid_nm[0]:g} to {grid_nm[-1]:g} nm",
            f"{np.asarray(size_nm)[wrong].flat[0]:g} nm ({int(np.count_nonzero(wrong))} such)",
            "use the library that the layout was made with, or build one that holds these sizes",
        )
    return nearest
