"""Frames one after the other: what has not changed since it was decoded is not decoded again."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, uniform_filter

from metafab.camera.frame import RawFrame
from metafab.decode.decoder import Decoder
from metafab.decode.image import Image4D
from metafab.decode.judge import judged
from metafab.decode.levels import Levels
from metafab.decode.restore import Sharp
from metafab.decode.seen import Seen
from metafab.decode.volume import Volume

#: Side of the window over which changes are pooled, and how many standard deviations of noise a change must pass: its
#: mean square has a longer tail than a Gaussian, and 6 of them let noise pass once in some dozen frames of 10^5 pixels.
_WINDOW = 7
_DEVIATIONS = 8.0
_SMALLEST_NOISE = 0.05


@dataclass
class VideoDecoder:
    """A decoder with a memory.

    Attributes:
        decoder: what decodes.
        changed_share: share of the last frame's pixels that were decoded anew.
    """

    decoder: Decoder
    changed_share: float = field(default=1.0, init=False)
    _last: tuple[NDArray[np.float32], Levels, Volume, Image4D, Sharp] | None = field(
        default=None, init=False, repr=False
    )

    def __call__(self, frame: RawFrame) -> Image4D:
        """Decode the next frame: where nothing moved, agreement of the twins and brightness are the last frame's.

        ``details`` get ``changed_share``. A frame that cannot be decoded is forgotten at once.
        """
        started = time.perf_counter()
        seen = self.decoder.look(frame, None if self._last is None else self._last[1])
        if not isinstance(seen, Seen):
            self._last, self.changed_share = None, 1.0
            return self.decoder(frame)
        if self._last is None:
            changed = np.ones(seen.lit.shape, dtype=bool)
            volume = self.decoder.volume(seen)
            image, sharp = self.decoder.finish(frame, seen, volume, started=started)
            self._last = seen.small, seen.levels, volume, image, sharp
        else:
            small, levels, volume, image, sharp = self._last
            moved = self._moved(small, seen)
            changed = self._reached(moved)
            if changed.any():
                volume = self.decoder.volume(seen, changed, volume)
                image, sharp = self.decoder.finish(frame, seen, volume, changed, sharp, started=started)
                self._last = np.where(moved, seen.small, small), levels, volume, image, sharp
            else:
                image = judged(image, frame, seconds=time.perf_counter() - started)
        self.changed_share = float(changed.mean())
        image.details["changed_share"] = self.changed_share
        return image

    def _moved(self, small: NDArray[np.float32], seen: Seen) -> NDArray[np.bool_]:
        """Where the reduced twins, margin included, differ from the remembered ones by more than their noise."""
        # Beside bright pixels some of their noise is mixed in: no pixel counts as quieter than a share of theirs.
        quietest = seen.levels.read_noise_e**2 + _SMALLEST_NOISE * seen.levels.noise_variance
        noise = np.maximum(0.5 * (small + seen.small), 0.0) + quietest
        noise = 2.0 * self.decoder.filters.reduction.variance_left * uniform_filter(noise, (0, _WINDOW, _WINDOW))
        change = uniform_filter((seen.small - small) ** 2, (0, _WINDOW, _WINDOW)) / np.maximum(noise, 1e-12)
        # Reduced pixels are nearly independent: the mean square of n of them is 1 +- sqrt(2 / n).
        return np.asarray((change > 1.0 + _DEVIATIONS * math.sqrt(2.0) / _WINDOW).any(axis=0))

    def _reached(self, moved: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Pixels of the window that filters or windows mix with something that moved."""
        reduction = self.decoder.filters.reduction
        wide = maximum_filter(moved, 2 * reduction.margin + 1)
        return np.asarray(wide[reduction.inner])
