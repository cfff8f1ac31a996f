"""The scene file: opaque objects at depths, each with texture and polarisation, photons and noise."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from metafab.spec.fields import CONFIG, Fraction, NonNegative, Positive, Real


@dataclass(frozen=True, config=CONFIG)
class SceneObject:
    """A flat, opaque piece facing the lens; nearer objects hide what is behind them.

    Position and size are directions as tangents (x/z, y/z), so a piece keeps its place in the image when its
    depth changes.
    """

    depth_m: Positive
    centre: tuple[Real, Real] = (0.0, 0.0)
    size: tuple[Positive, Positive] = (0.01, 0.01)
    outline: Literal["rectangle", "ellipse"] = "rectangle"
    brightness: Positive = 1.0
    polarisation_contrast: Annotated[Positive, Field(description="I_x / I_y")] = 1.0
    texture: Literal["uniform", "fractal", "checker"] = "fractal"
    texture_contrast: Annotated[Fraction, Field(description="rms over mean")] = 0.25


@dataclass(frozen=True, config=CONFIG)
class Scene:
    """A scene (table ``[scene]`` of a design, or a file of its own)."""

    objects: Annotated[tuple[SceneObject, ...], Field(min_length=1)]
    photons_per_pixel: Annotated[Positive, Field(description="mean electrons a pixel at brightness 1")] = 3000.0
    read_noise_e: NonNegative = 2.0
    background: Annotated[Fraction, Field(description="brightness behind all objects")] = 0.0
    field_px: tuple[Annotated[int, Field(strict=True, ge=8)], Annotated[int, Field(strict=True, ge=8)]] = (
        128,
        128,
    )
    seed: Annotated[int, Field(strict=True, ge=0)] = 1
