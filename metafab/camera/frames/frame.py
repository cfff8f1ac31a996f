"""A raw frame of the sensor, and the truth of a simulated one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.display import Displayed
from metafab.core.labelled import dataset

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True)
class Truth:
    """The result of a perfect decoder, on the geometric image grid of the x polarisation."""

    depth_m: FloatArray  #: Shape (n_y, n_x), NaN where the scene is empty.
    intensity_x: FloatArray  #: Shape (n_y, n_x), mean electrons of x-polarised light.
    intensity_y: FloatArray  #: Shape (n_y, n_x), mean electrons of y-polarised light.
    label: NDArray[np.int32]  #: Shape (n_y, n_x), number of the object from 1, 0 for none.


@dataclass(frozen=True, repr=False)
class RawFrame(Displayed):
    """One exposure.

    Attributes:
        frame: shape (n_y, n_x), electrons (or counts of a real camera).
        pixel_um: pixel pitch.
        origin_um: (x, y) on the sensor plane of the centre of pixel [0, 0].
        read_noise_e: standard deviation of the read noise.
        truth: present for simulated frames.
        truth_origin_um: (x, y) on the sensor plane of the centre of pixel [0, 0] of the truth's grid.
        x_window: (row, column, rows, columns) of the x polarisation's image, where the field stop is known.
        saturation_e: level at which pixels saturate, where it is known.
        saturation_assumed: whether the level was inferred, because many pixels share it exactly.
    """

    frame: FloatArray
    pixel_um: float
    origin_um: tuple[float, float]
    read_noise_e: float
    truth: Truth | None = None
    truth_origin_um: tuple[float, float] | None = None
    x_window: tuple[int, int, int, int] | None = None
    saturation_e: float | None = None
    saturation_assumed: bool = False

    @property
    def holds_window(self) -> bool:
        """Whether ``x_window`` lies in the frame, or is not known."""
        if self.x_window is None or self.frame.ndim != 2:
            return True
        row, column, rows, columns = self.x_window
        n_y, n_x = self.frame.shape
        return min(row, column) >= 0 and min(rows, columns) > 0 and row + rows <= n_y and column + columns <= n_x

    def key_figures(self) -> dict[str, str]:
        """Size, pixel and mean signal."""
        return {
            "pixels": " x ".join(str(count) for count in self.frame.shape),
            "pixel": f"{self.pixel_um:g} um",
            "mean": f"{self.frame.mean():.4g} electrons",
        }

    def to_xarray(self) -> xarray.Dataset:
        """The frame over (y_um, x_um) on the sensor; MissingToolError without xarray."""
        axes = pixel_axes(self.frame.shape, self.origin_um, self.pixel_um)
        return dataset({"frame": (tuple(axes), self.frame, "electron")}, axes)


def pixel_axes(shape: tuple[int, ...], origin_um: tuple[float, float], pixel_um: float) -> dict[str, FloatArray]:
    """Places on the sensor of the rows, ``y_um``, and columns, ``x_um``, of a picture of shape (n_y, n_x)."""
    starts = {"y_um": (origin_um[1], shape[0]), "x_um": (origin_um[0], shape[1])}
    return {name: np.asarray(start + pixel_um * np.arange(count)) for name, (start, count) in starts.items()}
