"""Scenes as they are: what the decoder sees at outlines, of small things, in haze; one row for each weakness.

Frames of the paper's lens (480 x 960 pixels, 3000 electrons) are photographed with a PSF stack that shares no node with
the calibration that decodes them. A row has the measured figure, a mean over seeds, its spread, and the goal. Pictures
of scikit-image are the textures of natural scenes; without it they are fractals, and rows say so.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib.util import find_spec
from typing import Any

import numpy as np

from benchmarks.scene_cases import CASES, Case, scene_of
from benchmarks.scene_judge import Decoded, reliability
from benchmarks.scene_stacks import Stacks
from metafab.benchmark import DepthView
from metafab.camera import RawFrame
from metafab.core.errors import InputError
from metafab.decode import Decoder

#: Seeds of textures, places and noise.
SEEDS = 5
#: Noise draws of the quick benchmark.
_QUICK_DRAWS = 5


def rows(quick: bool, only: Sequence[str] = (), seeds: int | None = None) -> list[dict[str, Any]]:
    """One row for each goal of each case.

    Args:
        quick: one seed, five noise draws.
        only: names of cases; all by default.
        seeds: number of seeds.

    Raises:
        InputError: no case has the name.
    """
    names = [case.name for case in CASES]
    if unknown := sorted(set(only) - set(names)):
        raise InputError.single("benchmark", "--only", f"some of {', '.join(names)}", ", ".join(unknown))
    chosen = [case for case in CASES if not only or case.name in only]
    return [row for case in chosen for row in _rows(case, quick, seeds or (1 if quick else SEEDS))]


def _rows(case: Case, quick: bool, seeds: int) -> list[dict[str, Any]]:
    """Rows of one case; the first has the picture of its first frame."""
    stacks, measured, seconds = _stacks(case.lens), [], []
    view: DepthView | None = None
    draws = min(case.draws, _QUICK_DRAWS) if quick else case.draws
    for seed in range(1, 1 + (seeds if case.draws == 1 else 1)):
        scene = scene_of(case, stacks, seed)
        of_draws = []
        for frame, _ in zip(stacks.frames(scene, seed, case.haze_e), range(draws), strict=False):
            decoder = _decoder(case.lens, frame)
            if not seconds:
                decoder(frame)  # compiles
            image = decoder(frame)
            seconds.append(image.figures.seconds or 0.0)
            seen = Decoded.of(image, frame)
            of_draws.append([goal.measure(seen) for goal in case.goals])
            view = view or _view(seen)
        measured.append(np.sum(of_draws, axis=0))
    mean, spread = np.mean(measured, axis=0), np.std(measured, axis=0)
    textures = "scikit-image" if find_spec("skimage") else "fractals"
    table: list[dict[str, Any]] = []
    for index, goal in enumerate(case.goals):
        value = float(mean[index])
        table.append(
            {
                "name": f"{case.name}: {goal.measure.__name__}",
                "weakness": case.weakness,
                "measured": value,
                "goal": goal.limit,
                "at_least": goal.at_least,
                "met": goal.met(value),
                "spread": float(spread[index]),
                "seeds": len(measured),
                "draws": draws,
                "seconds": float(np.mean(seconds)),
                "textures": textures,
                "view": view if index == 0 else None,
            }
        )
    return table


def _view(seen: Decoded) -> DepthView:
    parts = (seen.truth.intensity_x, seen.intensity[0], seen.truth.depth_m, seen.depth_m, seen.confidence)
    return DepthView(*parts, *reliability(seen)[:2])


@cache
def _stacks(lens: str) -> Stacks:
    return Stacks(lens)


_DECODERS: dict[tuple[Any, ...], Decoder] = {}


def _decoder(lens: str, frame: RawFrame) -> Decoder:
    """The decoder of frames of one shape, set up once."""
    key = (lens, frame.frame.shape, frame.origin_um, frame.x_window)
    if key not in _DECODERS:
        decoder = Decoder.of(_stacks(lens).calibration, *key[1:])
        if decoder is None:
            raise ValueError("the frame does not hold both images")
        _DECODERS[key] = decoder
    return _DECODERS[key]
