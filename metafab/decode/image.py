"""The decoded 4D image: two intensities, their contrast, depth, and its confidence; ``decoded.h5``."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from metafab.camera.frames.frame import pixel_axes, put_axes
from metafab.core.conventions import FloatArray
from metafab.core.display import Displayed, dataset
from metafab.core.figures import DecodingFigures, SegmentFigures
from metafab.core.storage import hdf5
from metafab.core.storage.files import plain, untimed
from metafab.core.storage.tables import applicable, typed

if TYPE_CHECKING:
    import xarray

DECODED_KIND = "metafab decoded image"
DECODED_FORMAT = 1

_DATASETS = (
    ("intensity_x", "e", "all-in-focus image, x polarisation"),
    ("intensity_y", "e", "all-in-focus image, y polarisation"),
    ("contrast", "1", "I_x / I_y, NaN without signal"),
    ("contrast_error", "1", "standard error of the contrast by photon and read noise, NaN without signal"),
    ("depth_m", "m", "depth of the segment, NaN where none is claimed"),
    ("confidence", "1", "0 to 1, 0 where no depth is claimed"),
    ("segment", "1", "number of the segment from 1, 0 for none"),
    ("depth_pixel_m", "m", "depth of the pixel from the window about it, NaN where none is claimed"),
)


@dataclass(frozen=True, repr=False)
class Image4D(Displayed):
    """All-in-focus polarisation images and depth on the geometric image grid of the x polarisation.

    Attributes:
        intensity_x: shape (n_y, n_x), electrons.
        intensity_y: shape (n_y, n_x), electrons.
        contrast: shape (n_y, n_x), I_x / I_y; NaN where there is no signal.
        depth_m: shape (n_y, n_x), depth of the pixel's segment; NaN where no depth is claimed.
        confidence: shape (n_y, n_x), 0 to 1 (:mod:`metafab.decode.confidence`); 0 where no depth is claimed.
        segment: shape (n_y, n_x), number of the segment from 1; 0 for none.
        origin_um: (x, y) on the sensor of the centre of pixel [0, 0].
        pixel_um: pixel pitch.
        segments: figures of each segment.
        depth_pixel_m: shape (n_y, n_x), depth of each pixel from the window around it; NaN where none is claimed.
        contrast_error: shape (n_y, n_x), standard error of each pixel's contrast by photon and read noise; NaN where
            there is no signal.
        nmae: mean |depth error| / depth over decoded pixels with known truth; None without truth.
        figures: figures of the decoding.
    """

    intensity_x: FloatArray
    intensity_y: FloatArray
    contrast: FloatArray
    depth_m: FloatArray
    confidence: FloatArray
    segment: NDArray[np.int32]
    origin_um: tuple[float, float]
    pixel_um: float
    segments: tuple[SegmentFigures, ...] = ()
    depth_pixel_m: FloatArray | None = None
    contrast_error: FloatArray | None = None
    nmae: float | None = None
    figures: DecodingFigures = field(default_factory=DecodingFigures)

    def key_figures(self) -> dict[str, str]:
        """Size, segments, depths and share of decoded pixels; why nothing was decoded."""
        known = np.isfinite(self.depth_m)
        depths = f"{self.depth_m[known].min():g} to {self.depth_m[known].max():g} m" if known.any() else "none"
        return {
            "pixels": " x ".join(str(count) for count in self.depth_m.shape),
            "segments": str(len(self.segments)),
            "depths": depths,
            "decoded": f"{100.0 * known.sum() / max(1, known.size):.1f} % of the pixels",
        } | ({} if self.figures.reason is None else {"reason": self.figures.reason})

    def to_xarray(self) -> xarray.Dataset:
        """All maps over (y_um, x_um); MissingToolError if xarray is not installed."""
        axes = pixel_axes(self.depth_m.shape, self.origin_um, self.pixel_um)
        units = {"intensity_x": "electron", "intensity_y": "electron", "contrast": "", "depth_m": "m", "confidence": ""}
        units["segment"] = ""
        return dataset({name: (tuple(axes), getattr(self, name), unit) for name, unit in units.items()}, axes)


def save(image: Image4D, path: Path | str, *, inputs_sha256: str = "") -> None:
    """Write a decoded image; an interrupted write leaves no file."""
    with hdf5.create(path, kind=DECODED_KIND, format_version=DECODED_FORMAT, inputs_sha256=inputs_sha256) as file:
        put_axes(file, image.depth_m.shape, image.origin_um, image.pixel_um)
        for name, units, description in _DATASETS:
            values = getattr(image, name)
            if values is not None:
                hdf5.put(file, name, values, units=units, description=description, dims=("y_um", "x_um"), compress=True)
        file.attrs["origin_um"] = image.origin_um
        file.attrs["pixel_um"] = image.pixel_um
        file.attrs["segments"] = json.dumps(plain(image.segments))
        file.attrs["details"] = json.dumps(plain(untimed(applicable(image.figures))))
        if image.nmae is not None:
            file.attrs["nmae"] = image.nmae


def load(path: Path | str) -> Image4D:
    """Read a decoded image; InputError if the file is missing, truncated, foreign or of a newer format."""
    remedy = "make it with `metafab decode RAW --psf PSF.h5`"
    with hdf5.open_kind(path, kind=DECODED_KIND, format_version=DECODED_FORMAT, remedy=remedy) as file:
        arrays = {name: np.asarray(file[name]) for name, _, _ in _DATASETS if name in file}
        origin, nmae = file.attrs["origin_um"], file.attrs.get("nmae")
        figures = json.loads(str(file.attrs["details"]))
        return Image4D(
            **arrays | {"segment": arrays["segment"].astype(np.int32)},
            origin_um=(float(origin[0]), float(origin[1])),
            pixel_um=float(file.attrs["pixel_um"]),
            segments=tuple(_segment_figures(row) for row in json.loads(str(file.attrs["segments"]))),
            nmae=None if nmae is None else float(nmae),
            figures=typed(DecodingFigures, figures),
        )


def _segment_figures(row: dict[str, float | None]) -> SegmentFigures:
    """Figures of one segment from its JSON object; a figure that is null or missing is NaN."""
    return typed(SegmentFigures, dict.fromkeys(item.name for item in fields(SegmentFigures)) | row)
