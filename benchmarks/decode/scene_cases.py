"""Scenes of the scene benchmark, their weaknesses and goals. Places and sizes are in pixels from the image's middle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.decode import scene_judge as judge
from benchmarks.decode.scene_judge import Decoded
from benchmarks.decode.scene_pictures import rgbd
from benchmarks.decode.scene_stacks import FIELD_PX, LAYOUTS, picture
from metafab.spec import Scene, SceneObject, load_design


@dataclass(frozen=True)
class Goal:
    """A measure with its goal, for the mean over seeds."""

    measure: Callable[[Decoded], float]  #: Of one decoded frame.
    limit: float  #: Goal of the measure.
    at_least: bool = False  #: Whether the measure must be at least the limit, and not at most.

    def met(self, measured: float) -> bool:
        """Whether a measured value reaches the goal."""
        return measured >= self.limit if self.at_least else measured <= self.limit


@dataclass(frozen=True)
class Case:
    """One scene with its goals."""

    name: str  #: Short name, for ``--only``.
    weakness: str  #: The weakness that it shows.
    #: Returns the scene, given a pixel's size as a tangent and a seed for what varies from draw to draw.
    scene: Callable[[float, int], Scene]
    goals: tuple[Goal, ...]  #: Measures with their goals.
    haze_e: float = 0.0  #: Mean stray electrons on every pixel.
    lens: str = "paper"  #: Lens of :class:`benchmarks.decode.scene_stacks.Stacks`.
    seeds: int | None = None  #: Number of seeds, if the case needs its own.


def _object(
    pixel: float,
    depth_m: float,
    centre_px: tuple[float, float] = (0.0, 0.0),
    size_px: tuple[float, float] = (1100.0, 600.0),
    photo: str | None = None,
    **fields: Any,
) -> SceneObject:
    """An object with places in pixels; the default is a wall that fills the field."""
    texture = {} if photo is None else picture(photo, *size_px)
    centre, size = ((pixel * pair[0], pixel * pair[1]) for pair in (centre_px, size_px))
    return SceneObject(depth_m=depth_m, centre=centre, size=size, **(texture | fields))


def _scene(*objects: SceneObject, field_px: tuple[int, int] = FIELD_PX, **fields: Any) -> Scene:
    return Scene(objects=objects, field_px=field_px, photons_per_pixel=3000.0, read_noise_e=2.0, **fields)


def _natural_1(pixel: float, seed: int) -> Scene:
    return _scene(
        _object(pixel, 0.6, photo="brick"),
        _object(pixel, 0.5, (-290, 60), (320, 260), "grass", polarisation_contrast=1.2),
        _object(pixel, 0.42, (-90, -60), (230, 230), "gravel", outline="ellipse", polarisation_contrast=2.5),
        _object(pixel, 0.35, (130, 70), (220, 220), "camera"),
        _object(pixel, 0.3, (260, -30), (180, 150), "coins", polarisation_contrast=0.6),
        _object(pixel, 0.26, (-330, -130), (210, 170), "astronaut", outline="ellipse", polarisation_contrast=1.1),
    )


def _natural_2(pixel: float, seed: int) -> Scene:
    return _scene(
        _object(pixel, 0.55, photo="gravel"),
        _object(pixel, 0.47, (300, 60), (280, 300), "coffee", tilt=(0.05, 0.0)),
        _object(pixel, 0.4, (10, 90), (250, 210), "chelsea", outline="ellipse", polarisation_contrast=1.6),
        _object(pixel, 0.34, (-310, 40), (230, 280), "text", polarisation_contrast=0.8),
        _object(pixel, 0.29, (-60, -120), (240, 150), "page"),
        _object(pixel, 0.255, (190, -140), (190, 160), "rocket", outline="ellipse", polarisation_contrast=2.0),
    )


def _edge(far_m: float, near_m: float) -> Callable[[float, int], Scene]:
    def scene(pixel: float, seed: int) -> Scene:
        objects = _object(pixel, far_m, (0, 0), (560, 400)), _object(pixel, near_m, (0, 0), (260, 180))
        return _scene(*objects, field_px=(320, 480))

    return scene


def _small_things(pixel: float, seed: int) -> Scene:
    rng = np.random.default_rng((seed, 20))
    depths_m, contrasts = rng.uniform(0.27, 0.5, 20), (1.0, 2.0, 0.5)
    places = [(-400 + 200 * (k % 5), -165 + 110 * (k // 5)) for k in range(20)]
    small = (
        _object(pixel, float(depths_m[k]), place, (20 + k, 20 + k), polarisation_contrast=contrasts[k % 3])
        for k, place in enumerate(places)
    )
    return _scene(_object(pixel, 0.6), *small)


def _fence(pixel: float, seed: int) -> Scene:
    bars = (_object(pixel, 0.3, (-400 + 80 * k, 0), (5, 420)) for k in range(11))
    return _scene(_object(pixel, 0.6), *bars)


def _stairs(step: float) -> Callable[[float, int], Scene]:
    def scene(pixel: float, seed: int) -> Scene:
        return _scene(*(_object(pixel, 0.35 * (1.0 + step) ** k, (160 * k - 400, 0), (160, 400)) for k in range(6)))

    return scene


def _dim(brightness: float) -> Callable[[float, int], Scene]:
    def scene(pixel: float, seed: int) -> Scene:
        bright = _object(pixel, 0.3, (-210, 0), (300, 300))
        return _scene(bright, _object(pixel, 0.4, (210, 0), (300, 300), brightness=brightness))

    return scene


def _three(pixel: float, wall_brightness: float = 1.0) -> tuple[SceneObject, ...]:
    """A wall and two textured objects before it."""
    return (
        _object(pixel, 0.5, photo="brick", brightness=wall_brightness),
        _object(pixel, 0.3, (-210, 0), (300, 300), "grass"),
        _object(pixel, 0.4, (210, 0), (300, 300), "gravel", polarisation_contrast=2.5),
    )


def _highlights(pixel: float, seed: int) -> Scene:
    rng = np.random.default_rng((seed, 40))
    lights = []
    for number in range(40):
        on_object = number % 2 == 0
        (left, right), half = ((-340, -80), 130) if on_object else ((-30, 30), 220)
        x, y = rng.uniform(left, right), rng.uniform(-half, half)
        depth_m = 0.3 if on_object else 0.5
        lights.append(
            _object(pixel, 0.9999 * depth_m, (x, y), (4, 4), outline="ellipse", texture="uniform", brightness=30.0)
        )
    return _scene(*_three(pixel), *lights, full_well_e=12000.0, bit_depth=12)


def _ball(pixel: float, seed: int) -> Scene:
    ball = _object(pixel, 0.4, (0, 0), (240, 240), outline="ellipse", bulge=(0.06, 0.06))
    return _scene(_object(pixel, 0.6, (0, 0), (560, 400)), ball, field_px=(320, 480))


def _plain(pixel: float, seed: int) -> Scene:
    return _scene(
        _object(pixel, 0.3, (-200, 0), (220, 200), texture="uniform"),
        _object(pixel, 0.42, (200, 0), (240, 240), outline="ellipse", texture="uniform", polarisation_contrast=2.0),
    )


def _sky(pixel: float, seed: int) -> Scene:
    """Objects before a photograph whose upper half is covered by an even sky at the same depth."""
    return _scene(
        _object(pixel, 0.58, photo="gravel"),
        _object(pixel, 0.9999 * 0.58, (0, 150), (1100, 300), texture="uniform"),
        _object(pixel, 0.45, (-300, 20), (220, 280), "brick", polarisation_contrast=1.3),
        _object(pixel, 0.38, (-40, -30), (200, 200), "camera", outline="ellipse"),
        _object(pixel, 0.33, (170, 60), (180, 220), "grass", polarisation_contrast=0.7),
        _object(pixel, 0.28, (340, -60), (160, 200), "chelsea"),
    )


def _plain_wall(pixel: float, seed: int) -> Scene:
    return _scene(
        _object(pixel, 0.55, texture="uniform", brightness=0.8),
        _object(pixel, 0.32, (-290, 30), (230, 250), "coins"),
        _object(pixel, 0.41, (20, -50), (220, 220), "grass", outline="ellipse", polarisation_contrast=1.4),
        _object(pixel, 0.36, (310, 40), (200, 260), "chelsea"),
    )


def _sides(pixel: float, seed: int) -> Scene:
    return _scene(_object(pixel, 0.33))


def _first_page(pixel: float, seed: int) -> Scene:
    scene = load_design(LAYOUTS / "helix_small.toml").scene
    if scene is None:
        raise ValueError("the small lens has no scene")
    return scene


_NATURAL = "natural textures, six objects before a wall"
_SURELY_RIGHT = Goal(judge.sure_and_wrong, 0.005), Goal(judge.miscalibration, 0.05)
_NATURAL_GOALS = Goal(judge.inside_error, 0.006), Goal(judge.decoded_share, 0.97, True), *_SURELY_RIGHT
_STAIRS = "stairs, each tread"
_SURE_GOALS = Goal(judge.sure_and_wrong, 0.01), Goal(judge.miscalibration, 0.05)
_PICTURE_GOALS = Goal(judge.all_error, 0.015), Goal(judge.decoded_share, 0.9, True), *_SURE_GOALS

CASES = (
    Case(
        "natural_1",
        _NATURAL,
        _natural_1,
        (Goal(judge.all_error, 0.010), *_NATURAL_GOALS),
    ),
    Case(
        "natural_2",
        _NATURAL,
        _natural_2,
        (Goal(judge.all_error, 0.015), *_NATURAL_GOALS),
    ),
    Case(
        "edge",
        "object at 0.30 m before a wall at 0.60 m: wall's pixels with the wrong depth",
        _edge(0.6, 0.3),
        (Goal(judge.wrong_side_near, 0.40), Goal(judge.wrong_side_far, 0.08)),
    ),
    Case(
        "small",
        "20 objects of 20 to 39 px before a wall",
        _small_things,
        (Goal(judge.found, 18.0, True), Goal(judge.wall_error, 0.001)),
    ),
    Case(
        "fence",
        "11 bars of 5 px before a wall",
        _fence,
        (Goal(judge.bars_found, 8.0, True), Goal(judge.bars_claimed, 0.0)),
    ),
    Case("planes", "touching planes at 0.36 and 0.35 m", _edge(0.36, 0.35), (Goal(judge.object_error, 0.0015),)),
    Case("stairs_1", _STAIRS, _stairs(0.01), (Goal(judge.worst_object_error, 0.002),)),
    Case("stairs_2", _STAIRS, _stairs(0.02), (Goal(judge.worst_object_error, 0.002),)),
    Case("stairs_5", _STAIRS, _stairs(0.05), (Goal(judge.worst_object_error, 0.002),)),
    Case(
        "dim_10",
        "object of 1/10 of the brightest",
        _dim(1.0 / 10.0),
        (Goal(judge.last_object_share, 0.98, True), Goal(judge.last_object_error, 0.003)),
    ),
    Case("dim_30", "object of 1/30 of the brightest", _dim(1.0 / 30.0), (Goal(judge.last_object_error, 0.01),)),
    Case(
        "dim_wall",
        "wall at 1/5 of the objects' light",
        lambda pixel, seed: _scene(*_three(pixel, wall_brightness=0.2)),
        (Goal(judge.wall_error, 0.003),),
    ),
    Case(
        "haze",
        "haze of 1500 electrons a pixel",
        lambda pixel, seed: _scene(*_three(pixel)),
        (Goal(judge.contrast_error, 0.01),),
        haze_e=1500.0,
    ),
    Case(
        "highlights",
        "40 saturated highlights of 30 times the light",
        _highlights,
        (Goal(judge.all_error, 0.002), Goal(judge.tails, 1.5)),
    ),
    Case("ball", "ball of 6 % rise", _ball, (Goal(judge.last_object_error, 0.005),)),
    Case("draws_1", "50 noise draws: an object that is 5 % off", _natural_1, (Goal(judge.has_astray, 0.0),), seeds=50),
    Case("draws_2", "50 noise draws: an object that is 5 % off", _natural_2, (Goal(judge.has_astray, 0.0),), seeds=50),
    Case(
        "plain",
        "plain objects with clear outlines",
        _plain,
        (Goal(judge.worst_object_error, 0.01), Goal(judge.decoded_share, 0.9, True), Goal(judge.pull, 3.0)),
    ),
    Case(
        "sky",
        "objects before a wall that is plain in its upper half",
        _sky,
        (Goal(judge.all_error, 0.015), *_SURELY_RIGHT),
    ),
    Case(
        "plain_wall",
        "objects before a wall without texture: the wall's pixels with an object's depth",
        _plain_wall,
        (Goal(judge.all_error, 0.015), *_SURELY_RIGHT),
    ),
    Case("sides", "own-pixel depth at the sides of the frame", _sides, (Goal(judge.side_bias, 0.001),)),
    Case(
        "first_page",
        "the small lens of the first page",
        _first_page,
        (Goal(judge.all_error, 0.002), Goal(judge.swapped, 0.0)),
        lens="small",
    ),
    Case("motorcycle", "a picture with its depth", rgbd("motorcycle", 3000.0), _PICTURE_GOALS),
    Case("motorcycle_500", "a picture with its depth in little light", rgbd("motorcycle", 500.0), _SURE_GOALS),
    Case("steps", "a photograph on steps of depth that its light hardly shows", rgbd("steps", 3000.0), _SURE_GOALS),
    Case("room", "a room with boxes in little light", rgbd("room", 300.0), _SURE_GOALS),
    Case(
        "plain_ground",
        "plain dim ground about textured objects",
        rgbd("plain_ground", 3000.0),
        _SURE_GOALS,
    ),
)
