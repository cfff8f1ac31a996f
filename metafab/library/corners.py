"""Models of a library over its axes, and the amplitudes and errors of one corner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from metafab.core.conventions import FloatArray
from metafab.core.figures import CornerStatistics
from metafab.library.axes import Corner, CornerBox
from metafab.library.fit.certificate import NEIGHBOURS, disagreement_estimate, steepness
from metafab.library.fit.models import RankedModels
from metafab.library.fit.rational import RationalModel


@dataclass(frozen=True)
class Corners:
    """Models over sizes and axes, with the solved cells that bound their error."""

    models: RankedModels  #: The model that is used, and its rivals of other degrees.
    safety_factor: float  #: Ratio of held-out errors to the models' disagreement, at least 1.
    floor: float  #: Least estimate of the model's error: the rms held-out error.
    place: FloatArray  #: Shape (n, 2 + n_variables), the solved cells in the box of sizes and axes, each in -1..1.
    certificate: FloatArray  #: Shape (n,), the solver's error at each.
    statistics: CornerStatistics = CornerStatistics()  #: Figures of the sampling.

    def at(
        self, box: CornerBox, corner: Corner, width_nm: FloatArray, length_nm: FloatArray, exchange: bool
    ) -> tuple[RationalModel, FloatArray, FloatArray]:
        """Return the model of a corner's drawn sizes, and its error at and around each: shape (n_length, n_width).

        The grid of sizes has the axes ``width_nm``, shape (n_width,), and ``length_nm``. ``corner`` holds a value for
        every axis, as :meth:`CornerBox.completed` returns; ``exchange`` says whether t_xx(W, L) = t_yy(L, W) there.
        """
        bias_nm, axes = corner.get("cd_bias_nm", 0.0), box.to_variables(corner)
        models = self.models.at(axes, bias_nm)
        best = models.best

        def model_error(disagreement: FloatArray) -> FloatArray:
            estimate = disagreement_estimate(disagreement, exchange)
            return np.asarray(np.maximum(self.safety_factor * estimate, self.floor), dtype=np.float64)

        on_grid = model_error(models.disagreement(width_nm, length_nm))
        around = model_error(models.disagreement(width_nm, length_nm, around=True))
        certificate = self._certificate(box, width_nm + bias_nm, length_nm + bias_nm, axes)
        return best, certificate + on_grid, certificate * steepness(best, width_nm, length_nm) + around

    def _certificate(self, box: CornerBox, width_nm: FloatArray, length_nm: FloatArray, axes: FloatArray) -> FloatArray:
        """The solver's error at each size: the largest of the nearest solved cells, shape (n_length, n_width)."""
        width, length = np.meshgrid(width_nm, length_nm)
        points = box.points(width.ravel(), length.ravel(), np.tile(axes, (width.size, 1)))
        count = min(NEIGHBOURS, self.certificate.size)
        near = cKDTree(self.place).query(points, k=count)[1].reshape(*width.shape, count)
        return np.asarray(self.certificate[near].max(axis=-1), dtype=np.float64)
