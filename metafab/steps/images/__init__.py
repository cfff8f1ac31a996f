"""Images of a run: raw frames, and the 4D images decoded from them.

- ``frames``    raw frames of a scene, films and batches; the step ``capture``
- ``decoding``  4D images, decoded films, camera calibration; the step ``decode``
"""

from metafab.steps.images.decoding import DECODE, DecodeFigures, FilmFigures, calibrate, decode_file, decoded_film
from metafab.steps.images.frames import CAPTURE, CaptureFigures, capture, capture_batch, frame_files, of_scene_file

__all__ = [
    "CAPTURE",
    "DECODE",
    "CaptureFigures",
    "DecodeFigures",
    "FilmFigures",
    "calibrate",
    "capture",
    "capture_batch",
    "decode_file",
    "decoded_film",
    "frame_files",
    "of_scene_file",
]
