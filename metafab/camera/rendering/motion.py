"""Moving objects: the scene at one time, and the times at which the rows of the sensor are exposed."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.spec.scene import Scene

#: Most instants of one exposure.
_MOST_INSTANTS = 64


def moved(scene: Scene, time_s: float) -> Scene:
    """The scene at a time after the start of the first frame; objects that come nearer look larger."""
    if time_s == 0.0 or not any(piece.moves for piece in scene.objects):
        return scene
    objects = []
    for piece in scene.objects:
        if not piece.moves:
            objects.append(piece)
            continue
        v_x, v_y, v_z = piece.velocity_m_per_s
        depth_m = piece.depth_m + v_z * time_s
        centre = (
            (piece.centre[0] * piece.depth_m + v_x * time_s) / depth_m,
            (piece.centre[1] * piece.depth_m + v_y * time_s) / depth_m,
        )
        scale = piece.depth_m / depth_m
        size = (piece.size[0] * scale, piece.size[1] * scale)
        objects.append(dataclasses.replace(piece, depth_m=depth_m, centre=centre, size=size))
    return dataclasses.replace(scene, objects=tuple(objects))


@dataclass(frozen=True)
class Shutter:
    """Instants of a moving scene whose mean is the exposure of one frame, row by row."""

    instants_s: FloatArray  #: Shape (n_instants,), middles of equal parts of the frame's time.
    weights: FloatArray  #: Shape (n_rows, n_instants), share of each instant in each row's exposure; rows sum to 1.
    middle_s: FloatArray  #: Shape (n_rows,), middle of each row's exposure.

    @classmethod
    def of(cls, scene: Scene, start_s: float, rows: int, pixel_tangent: float) -> Shutter:
        """The shutter of a frame that starts at ``start_s``; the lowest of its ``rows`` is exposed first.

        There is one instant per pixel (of ``pixel_tangent``) of the fastest motion in the frame's time, at most 64.
        """
        delay_s = np.multiply(scene.row_time_s, np.arange(rows), dtype=np.float64)
        span_s = float(delay_s[-1]) + scene.exposure_s
        count = min(_MOST_INSTANTS, max(1, math.ceil(_travel(scene, start_s, span_s) / pixel_tangent)))
        part_s = span_s / count
        middle_s: FloatArray = start_s + delay_s + 0.5 * scene.exposure_s
        instants_s = start_s + np.multiply(part_s, np.arange(count) + 0.5, dtype=np.float64)
        if count == 1:
            return cls(instants_s, np.ones((rows, 1)), middle_s)
        # An exposure shorter than the parts is shared between the two nearest instants.
        open_s = max(scene.exposure_s, part_s)
        begin_s = np.clip(delay_s + 0.5 * (scene.exposure_s - open_s), 0.0, span_s - open_s)[:, None]
        first_s = part_s * np.arange(count)
        overlap_s = np.minimum(begin_s + open_s, first_s + part_s) - np.maximum(begin_s, first_s)
        return cls(instants_s, np.maximum(overlap_s, 0.0) / open_s, middle_s)


def _travel(scene: Scene, start_s: float, span_s: float) -> float:
    """Largest motion of any edge in a time, as a tangent."""
    first, last = moved(scene, start_s), moved(scene, start_s + span_s)
    return max(
        (
            math.dist(a.centre, b.centre) + 0.5 * max(abs(a.size[0] - b.size[0]), abs(a.size[1] - b.size[1]))
            for a, b in zip(first.objects, last.objects, strict=True)
        ),
        default=0.0,
    )
