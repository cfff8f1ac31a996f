"""The library away from its nominal cell: a corner is an ordinary Library, with the error that it has there."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from metafab.cell import is_square
from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.storage.files import fingerprint
from metafab.library.axes import Corner, CornerBox, corner_unit_cell
from metafab.library.fit.certificate import NEIGHBOURS, spread, steepness
from metafab.library.fit.corner_model import CornerModel
from metafab.library.fit.models import ModelPair

if TYPE_CHECKING:
    from metafab.library.library import Library


@dataclass(frozen=True)
class Corners:
    """What a library knows at all values of its axes.

    Attributes:
        models: the one to use, and its rivals; where all agree, none hangs on its own degrees.
        factor: how far their disagreement fell short at cells that neither knew, at least 1.
        floor: least estimate of the model's error anywhere: the rms miss of cells that it could not know.
        place: shape (n, 2 + n_variables), the solved cells in the box of sizes and axes, each in -1..1.
        certificate: shape (n,), the solver's error at each.
        details: figures of the sampling.
    """

    models: tuple[CornerModel, ...]
    factor: float
    floor: float
    place: FloatArray
    certificate: FloatArray
    details: dict[str, float | str] = field(default_factory=dict)


def library_at(library: Library, asked: Corner) -> Library:
    """The library at one corner: the same sizes, with the amplitudes and errors that they have there.

    Raises:
        InputError: an axis is none of the library's, or a value lies outside its span.
    """
    box, corners = CornerBox.of(library.unit_cell), library.corners
    if box is None or corners is None:
        if not asked:
            return library
        got, remedy = "a library of sizes alone", "name the axes in `[sweep.axes]` of the unit cell and build again"
        raise InputError.single("library", ", ".join(asked), "axes of the library", got, remedy)
    corner = box.whole(asked)
    if corner == box.nominal:
        return library
    bias_nm, axes = corner.get("cd_bias_nm", 0.0), box.variables_of(corner)
    best, *rivals = (model.at(axes, bias_nm) for model in corners.models)
    pairs = [ModelPair(best, rival) for rival in rivals]
    sizes = library.width_nm, library.length_nm
    exchange = box.exchanges and is_square(library.unit_cell) and np.array_equal(*sizes)
    values = best.on_grid(*sizes)
    certificate = _certificate(corners, box, library, bias_nm, axes)
    on_grid, around = (
        np.maximum(corners.factor * spread(np.max(apart, axis=0), exchange), corners.floor)
        for apart in (
            [pair.disagreement(*sizes) for pair in pairs],
            [pair.disagreement_around(*sizes) for pair in pairs],
        )
    )
    unit_cell = corner_unit_cell(library.unit_cell, corner)
    return replace(
        library,
        unit_cell=unit_cell,
        wavelength_nm=np.array([unit_cell.illumination.wavelength_nm]),
        t_xx=values[0][None],
        t_yy=values[1][None],
        r_xx=values[2][None],
        r_yy=values[3][None],
        error=(certificate + on_grid)[None],
        inputs_sha256=fingerprint(library.inputs_sha256, sorted(corner.items())),
        details={**corner, "max_error": float((certificate + on_grid).max())},
        model=best,
        model_error=certificate * steepness(best, *sizes) + around,
        corners=None,
        corner=corner,
    )


def _certificate(corners: Corners, box: CornerBox, library: Library, bias_nm: float, axes: FloatArray) -> FloatArray:
    """The solver's error at each size: the largest of the nearest solved cells, shape (n_length, n_width)."""
    width_nm, length_nm = np.meshgrid(library.width_nm + bias_nm, library.length_nm + bias_nm)
    grid = box.places(width_nm.ravel(), length_nm.ravel(), np.tile(axes, (width_nm.size, 1)))
    count = min(NEIGHBOURS, corners.certificate.size)
    near = cKDTree(corners.place).query(grid, k=count)[1].reshape(*width_nm.shape, count)
    return np.asarray(corners.certificate[near].max(axis=-1), dtype=np.float64)
