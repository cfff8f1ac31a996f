"""Resident memory of the decoder over thousands of frames, decoded one by one and as films with motion.

The frames of a film are shown forwards and backwards, each of them four times with fresh photon noise: objects that
stop and go on.

- ``resident_mb`` is the memory after a tenth of the frames, ``last_mb`` that after all.
- ``growth_mb`` is the change over 10 000 frames, from the straight line through the memory of the last nine tenths.
- ``seconds`` is the processor time of a frame, ``error`` the mean NMAE.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.decode.decode import DESIGN, OUTDOOR_DESIGN, optics_of
from metafab import camera, decode, optics
from metafab.camera import RawFrame
from metafab.core.parallel.measure import resident_mb
from metafab.spec import Scene, load_design

#: Frames of a film before it is shown backwards.
FILM_FRAMES = 10
#: Frames of a film of small ones for one that is decoded by itself, and for one of full size.
FILM_FOR_SINGLE, FILM_FOR_LARGE = 16, 40
#: Times that a frame is shown before the next one.
SHOWN = 4
#: Memory is read so many times in a run.
READINGS = 200


def rows(quick: bool, samples: int | None = None) -> list[dict[str, Any]]:
    """A row of each decoder: small frames by themselves and as a film, and a film of full size."""
    count = max(2, samples or (200 if quick else 10_000))
    design = load_design(DESIGN)
    source, imaging, depth_m = optics_of(design)
    psf = optics.psf(source, imaging, depth_m)
    small, decoder = _film(_moving(design.scene), psf)
    size = " x ".join(str(n) for n in small[0].frame.shape)
    table = [
        row_of(f"film of {size} pixels", small, decode.VideoDecoder(decoder), count),
        row_of(f"frames of {size} pixels by themselves", small, decoder, max(2, count // FILM_FOR_SINGLE)),
    ]
    if quick:
        return table
    design = load_design(OUTDOOR_DESIGN)
    source, imaging, depth_m = optics_of(design)
    psf = optics.psf(source, imaging, depth_m, field_tangents=optics.field_tangents(design, imaging))
    large, decoder = _film(dataclasses.replace(design.scene, frames=FILM_FRAMES), psf)
    size = " x ".join(str(n) for n in large[0].frame.shape)
    return [
        *table,
        row_of(f"film of {size} pixels", large, decode.VideoDecoder(decoder), max(2, count // FILM_FOR_LARGE)),
    ]


def _moving(scene: Scene) -> Scene:
    """A film of a scene in which the first object moves by its width."""
    first, *others = scene.objects
    speed = first.size[0] * first.depth_m / (scene.frame_interval_s * FILM_FRAMES)
    moving = dataclasses.replace(first, velocity_m_per_s=(speed, 0.0, 0.0))
    return dataclasses.replace(scene, objects=(moving, *others), frames=FILM_FRAMES)


def _film(scene: Scene, psf: optics.Psf) -> tuple[list[RawFrame], decode.Decoder]:
    """Frames of a scene, and a decoder for them."""
    frames = list(camera.film(scene, psf))
    decoder = decode.Decoder.of(psf, frames[0].frame.shape, frames[0].origin_um, frames[0].x_window)
    if decoder is None:
        raise ValueError("the frame does not hold both images")
    return frames, decoder


def row_of(name: str, film: list[RawFrame], decoder: Callable[[RawFrame], Any], count: int) -> dict[str, Any]:
    """Decode ``count`` frames, at least two, and read the resident memory as they go."""
    rng, order = np.random.default_rng(1), [frame for frame in [*film, *film[-2:0:-1]] for _ in range(SHOWN)]
    every, seconds, errors, readings = max(1, count // READINGS), 0.0, [], []
    for index, frame in zip(range(count), itertools.cycle(order), strict=False):
        light = rng.poisson(np.maximum(frame.frame, 0.0)).astype(np.float32)
        start = time.process_time()
        image = decoder(dataclasses.replace(frame, frame=light))
        seconds += time.process_time() - start
        errors.append(math.nan if image.nmae is None else image.nmae)
        if index % every == 0:
            readings.append((index, resident_mb()))
    frames, memory = np.array([one for one in readings if one[0] >= 0.1 * count]).T
    slope = float(np.polyfit(frames, memory, 1)[0]) if frames.size > 1 else math.nan
    return {
        "name": name,
        "error": float(np.nanmean(errors)),
        "seconds": seconds / count,
        "peak_rss_mb": max(reading for _, reading in readings),
        "frames": count,
        "resident_mb": float(memory[0]),
        "last_mb": float(memory[-1]),
        "growth_mb": 1e4 * slope,
    }
