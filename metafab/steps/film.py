"""A moving scene photographed and decoded frame by frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metafab.core.errors import InputError
from metafab.core.parallel.progress import Progress, silent
from metafab.spec import Scene

if TYPE_CHECKING:
    from metafab.camera import RawFrame
    from metafab.decode import Image4D


def decoded_film(
    scene: Scene, psf_path: Path, frames: int | None, *, seed: int | None = None, progress: Progress = silent
) -> Iterator[tuple[RawFrame, Image4D]]:
    """Raw and decoded frames, one by one: the decoder keeps what does not change.

    Args:
        scene: what is filmed.
        psf_path: the PSF pair, with which the film is made and decoded.
        frames: how many; the scene's own number by default.
        seed: of textures and noise; the scene's by default.
        progress: called while a frame is exposed.

    Raises:
        InputError: the pair does not suit the scene, or its frames do not hold both images.
    """
    from metafab import camera, decode, optics

    pair = optics.load(psf_path)
    shown = scene if frames is None else replace(scene, frames=frames)
    decoder = None
    for raw in camera.film(shown, pair, seed=seed, progress=progress):
        if decoder is None:
            still = decode.Decoder.of(pair, raw.frame.shape, raw.origin_um, raw.x_window)
            if still is None:
                raise InputError.single(
                    str(psf_path), "psf", "a calibration of a camera that shows both images", "one that does not",
                    "calibrate the pair over the field",
                )  # fmt: skip
            decoder = decode.VideoDecoder(still)
        yield raw, decoder(raw)


def film_figures(film: Sequence[tuple[RawFrame, Image4D]]) -> dict[str, Any]:
    """Errors and times of a decoded film, one entry a frame; ``objects`` by the number of each object of the scene."""
    from metafab.decode import object_errors

    names = ("nmae_pixel", "object_error", "worst_object_error", "contrast_error", "share_decoded", "changed_share")
    images = [image for _, image in film]
    return {
        "frames": len(images),
        "nmae": [image.nmae for image in images],
        **{name: [getattr(image.figures, name) for image in images] for name in names},
        "objects": [object_errors(image, raw) for raw, image in film],
        "decode_seconds": [image.figures.seconds for image in images],
    }
