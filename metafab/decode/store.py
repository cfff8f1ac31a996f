"""Decoded images in HDF5: ``decoded.h5``."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path

import numpy as np

from metafab.camera.frames.store import put_axes
from metafab.core.figures import DecodingFigures, SegmentFigures
from metafab.core.storage import hdf5
from metafab.core.storage.files import plain, untimed
from metafab.core.storage.tables import applicable, typed
from metafab.decode.image import Image4D

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


def save(image: Image4D, path: Path, *, inputs_sha256: str = "") -> None:
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
