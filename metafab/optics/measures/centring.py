"""Centre of the pictures of a point over depth: of mass, of the main lobes, or of the circle on which a lobe turns."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.optics.measures.metrics import main_lobe_px

#: Rule for the centre of a channel: mean over depth of the mass centres or of the main lobes, the centre of the circle
#: on which the main lobe turns, or the middle pixel. "auto" is "turn" where a circle fits and "mass" elsewhere.
Centring: TypeAlias = Literal["auto", "mass", "brightest", "turn", "none"]

#: A circle fits main lobes with an rms residual up to this share of its radius, over this arc at least (degrees).
_CIRCLE, _LEAST_ARC_DEG = 0.1, 30.0
#: Error of a centre, and range of the centres of mass over depth, above which there is a warning, pixels.
_TOLD_ERROR_PX, _TOLD_DRIFT_PX = 0.25, 1.0


@dataclass(frozen=True)
class Centre:
    """Centre of one channel's pictures."""

    rule: str  #: Rule by which it was found.
    place_px: tuple[float, float]  #: (x, y) from the middle pixel ``[n_y // 2, n_x // 2]``.
    error_px: float = math.nan  #: Standard error by the scatter of the lobes about their circle; NaN for other rules.
    drift_px: float = 0.0  #: Range over depth of the centres of mass, where these were taken for want of a circle.

    @property
    def warning(self) -> str | None:
        """Sentence on a centre that depth cannot rely on."""
        if self.error_px > _TOLD_ERROR_PX:
            return (
                f"the centre of the circle on which the lobe turns is known to {self.error_px:.2g} px, and depth moves "
                "with it: photograph over more of a turn, with more light, or centre the pictures yourself"
            )
        if self.drift_px > _TOLD_DRIFT_PX:
            return (
                f"the light moves by {self.drift_px:.2g} px over the depths, but on no circle: the mean centre of mass "
                "was taken, and depth moves with it; photograph over more of a turn, or choose another centre"
            )
        return None


def find_centre(channel: FloatArray, centring: Centring) -> Centre:
    """Find the centre of a channel's pictures over depth, shape (n_depth, n_y, n_x), without background.

    InputError if a circle is asked for and none fits.
    """
    if centring == "none":
        return Centre("none", (0.0, 0.0))
    if centring in {"auto", "turn", "brightest"}:
        lobes = np.array([main_lobe_px(picture)[:2] for picture in channel])
        if centring == "brightest":
            return Centre("brightest", _pair(lobes.mean(axis=0)))
        if (circle := _circle_centre(lobes)) is not None:
            return circle
        if centring == "turn":
            expected = f"main lobes on a circle, over {_LEAST_ARC_DEG:g} degrees or more"
            raise InputError.single("PSF stack", "centring", expected, "other places", "choose `mass`")
    n_y, n_x = channel.shape[1:]
    total = channel.sum(axis=(1, 2))
    x = (channel.sum(axis=1) @ (np.arange(n_x) - n_x // 2)) / total
    y = (channel.sum(axis=2) @ (np.arange(n_y) - n_y // 2)) / total
    drift_px = math.hypot(np.ptp(x), np.ptp(y)) if centring == "auto" else 0.0
    return Centre("mass", (float(x.mean()), float(y.mean())), drift_px=drift_px)


def _pair(place: FloatArray) -> tuple[float, float]:
    return float(place[0]), float(place[1])


def _circle_centre(places: FloatArray) -> Centre | None:
    """Centre of the least-squares circle (Kasa 1976) through places, shape (n, 2); None where none fits them.

    Its error is that of a circle fitted to the distances, the larger one along its axes.
    """
    if len(places) < 4:  # three places always have a circle
        return None
    matrix = np.column_stack([places, np.ones(len(places))])
    solved, _, rank, _ = np.linalg.lstsq(matrix, (places**2).sum(axis=1), rcond=None)
    if rank < 3:
        return None
    centre = 0.5 * solved[:2]
    spokes = places - centre
    radius = np.hypot(*spokes.T)
    arc_deg = np.degrees(np.ptp(np.unwrap(np.arctan2(spokes[:, 1], spokes[:, 0]))))
    if not (np.std(radius) <= _CIRCLE * radius.mean() and radius.mean() >= 1.0 and arc_deg >= _LEAST_ARC_DEG):
        return None
    design = np.column_stack([spokes / radius[:, None], np.ones(len(places))])
    variance = float(((radius - radius.mean()) ** 2).sum()) / (len(places) - 3)
    covariance = variance * np.linalg.inv(design.T @ design)[:2, :2]
    return Centre("turn", _pair(centre), math.sqrt(float(np.linalg.eigvalsh(covariance)[-1])))
