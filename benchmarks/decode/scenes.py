"""Scenes as they are: what the decoder sees at outlines, of small things, in haze; one row for each weakness.

Frames of the paper's lens (480 x 960 pixels, 3000 electrons) are photographed with a PSF stack that shares no node with
the calibration that decodes them. A row has the measured figure, a mean over seeds, its spread, and the goal. Pictures
of scikit-image are the textures of natural scenes; without it they are fractals, and rows say so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.decode.scene_cases import CASES, Case
from benchmarks.decode.scene_judge import Decoded, reliability
from benchmarks.decode.scene_stacks import KEPT, Stacks
from metafab.benchmark import DepthView
from metafab.camera import RawFrame
from metafab.core.errors import InputError
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.files import file_sha256, fingerprint, plain, read_json, write_json
from metafab.core.storage.provenance import sources_sha256
from metafab.decode import Decoder

#: Seeds of textures, places and noise.
SEEDS = 5
#: Noise draws of the quick benchmark.
_QUICK_DRAWS = 5
_KIND = "metafab scene figures"


@dataclass(frozen=True)
class Figures:
    """Figures of one decoded frame."""

    measured: tuple[float, ...]  #: Those of the case's goals.
    seconds: float  #: Time of decoding.

    @classmethod
    def of(cls, table: Mapping[str, Any]) -> Figures:
        """Read figures from their file; infinities are written as words."""
        return cls(tuple(float(one) for one in table["measured"]), float(table["seconds"]))


def rows(
    quick: bool, only: Sequence[str] = (), seeds: int | None = None, progress: Progress = silent
) -> list[dict[str, Any]]:
    """One row for each goal of each case.

    Frames and their figures are kept: a run that was stopped goes on where it was, and only frames that camera or
    decoder would treat in another way are made or decoded again.

    Args:
        quick: one seed, five noise draws.
        only: names of cases; all by default.
        seeds: number of seeds, at most.
        progress: called over the frames.

    Raises:
        InputError: no case has the name.
    """
    names = [case.name for case in CASES]
    if unknown := sorted(set(only) - set(names)):
        raise InputError.single("benchmark", "--only", f"some of {', '.join(names)}", ", ".join(unknown))
    chosen = {case: _seeds(case, quick, seeds) for case in CASES if not only or case.name in only}
    done, total, table = 0, sum(chosen.values()), []
    progress("scenes", 0, total)
    for case, count in chosen.items():
        table += _rows(case, count, partial(_advance, progress, done, total))
        done += count
    return table


def _advance(progress: Progress, before: int, total: int, done: int) -> None:
    progress("scenes", before + done, total)


def _seeds(case: Case, quick: bool, seeds: int | None) -> int:
    """Number of a case's seeds."""
    if case.seeds is None:
        return seeds or (1 if quick else SEEDS)
    return min(case.seeds, _QUICK_DRAWS if quick else case.seeds, seeds or case.seeds)


def _rows(case: Case, seeds: int, advance: Callable[[int], None]) -> list[dict[str, Any]]:
    """Rows of one case; the first has the picture of its first frame."""
    stacks, judged = _stacks(case.lens), []
    view: DepthView | None = None
    scenes = {seed: case.scene(stacks.pixel_tangent, seed) for seed in range(1, seeds + 1)}
    for kept in stacks.frames(scenes, case.haze_e):
        file = KEPT / "judged" / f"{fingerprint(case.name, kept.mark, _code_sha256())[:20]}.json"
        figures = None if view is None else read_json(file, _KIND, 1, Figures.of)
        if figures is None:
            frame = kept.load()
            decoder = _decoder(case.lens, frame)
            if view is None:
                decoder(frame)  # compiles
            seen = Decoded.of(decoder(frame), frame)
            view = view or _view(seen)
            measured = tuple(goal.measure(seen) for goal in case.goals)
            figures = Figures(measured, seen.image.figures.seconds or 0.0)
            file.parent.mkdir(parents=True, exist_ok=True)
            write_json(file, {"kind": _KIND, "format_version": 1} | plain(figures))
        judged.append(figures)
        advance(len(judged))
    table = np.array([one.measured for one in judged])
    mean, spread, textures = table.mean(axis=0), table.std(axis=0), find_spec("skimage")
    return [
        {
            "name": f"{case.name}: {goal.measure.__name__}",
            "weakness": case.weakness,
            "measured": value,
            "goal": goal.limit,
            "at_least": goal.at_least,
            "met": goal.met(value),
            "spread": float(spread[index]),
            "seeds": len(judged),
            "seconds": float(np.median([one.seconds for one in judged])),
            "textures": "fractals" if textures is None else "scikit-image",
            "view": view if index == 0 else None,
        }
        for index, (goal, value) in enumerate(zip(case.goals, mean.tolist(), strict=True))
    ]


@cache
def _code_sha256() -> str:
    """Hash of the decoder, of the measures and of the cases."""
    here = Path(__file__).parent
    measures = [file_sha256(here / name) for name in ("scene_cases.py", "scene_judge.py")]
    return fingerprint(sources_sha256(("metafab.decode",), ()), *measures)


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
