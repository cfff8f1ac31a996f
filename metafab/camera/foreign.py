"""Frames of a real camera: TIFF and PNG of 8, 12 or 16 bit, and NumPy arrays."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from metafab.camera.frame import RawFrame
from metafab.camera.store import load
from metafab.core.pictures import read_counts
from metafab.optics.point_spread import Psf


def load_frame(path: Path, psf: Psf, *, read_noise_e: float = 0.0, first_row: str = "top") -> RawFrame:
    """A frame from a file: metafab's own, or a real camera's with the optical axis assumed at its centre.

    Args:
        path: a ``raw.h5``, a grey TIFF or PNG (8 to 16 bit; 12-bit counts are taken as they are), a 2-D ``.npy``.
        psf: the calibration; its ``pixel_um`` is the camera's pixel pitch.
        read_noise_e: standard deviation of the read noise, in counts.
        first_row: whether the file's first row is the picture's "top" (as TIFF and PNG have it) or "bottom".

    Returns:
        The frame with its lowest row first, as everywhere in metafab. Pixels at the file type's largest value
        are saturated: the level travels with the frame.

    Raises:
        InputError: the file cannot be read, or is no grey picture.
    """
    if path.suffix.lower() in {".h5", ".hdf5"}:
        return load(path)
    counts, saturation = read_counts(path)
    frame = counts[::-1] if first_row == "top" else counts
    n_y, n_x = frame.shape
    origin_um = (-psf.pixel_um * (n_x // 2), -psf.pixel_um * (n_y // 2))
    return RawFrame(np.ascontiguousarray(frame), psf.pixel_um, origin_um, read_noise_e, saturation_e=saturation)
