"""The scene file: opaque objects at depths, each with texture and polarisation, photons and noise."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from metafab.spec.fields import CONFIG, Fraction, NonNegative, Positive, Real


@dataclass(frozen=True, config=CONFIG)
class SceneObject:
    """A flat, opaque piece; nearer objects hide what is behind them.

    Position and size are directions as tangents (x/z, y/z), so a piece keeps its place in the image when its
    depth changes. ``depth_m`` is the depth of its centre; a tilted piece is nearer or farther elsewhere.
    """

    depth_m: Positive
    centre: tuple[Real, Real] = (0.0, 0.0)
    size: tuple[Positive, Positive] = (0.01, 0.01)
    outline: Literal["rectangle", "ellipse"] = "rectangle"
    tilt: Annotated[
        tuple[Real, Real], Field(description="change of depth over depth at the centre, along the full size in x and y")
    ] = (0.0, 0.0)
    brightness: Positive = 1.0
    polarisation_contrast: Annotated[Positive, Field(description="I_x / I_y")] = 1.0
    texture: Literal["uniform", "fractal", "checker", "image"] = "fractal"
    texture_contrast: Annotated[Fraction, Field(description="rms over mean")] = 0.25
    velocity_m_per_s: Annotated[
        tuple[Real, Real, Real], Field(description="along x, y and away from the lens; the first frame starts in place")
    ] = (0.0, 0.0, 0.0)
    texture_file: Annotated[Path | None, Field(description="picture of an object with the texture 'image'")] = None

    @model_validator(mode="after")
    def _picture(self) -> SceneObject:
        if (self.texture == "image") != (self.texture_file is not None):
            raise ValueError("`texture_file` belongs to texture = 'image', and only to it")
        return self

    @model_validator(mode="after")
    def _tilt(self) -> SceneObject:
        if abs(self.tilt[0]) + abs(self.tilt[1]) > 1.0:
            raise ValueError("`tilt` must change the depth by at most half of itself either way: |x| + |y| <= 1")
        return self


@dataclass(frozen=True, config=CONFIG)
class Scene:
    """A scene (table ``[scene]`` of a design, or a file of its own)."""

    objects: Annotated[tuple[SceneObject, ...], Field(min_length=1)]
    photons_per_pixel: Annotated[
        Positive, Field(description="electrons a pixel at brightness 1, mean of both polarisations' images")
    ] = 3000.0
    read_noise_e: NonNegative = 2.0
    dark_e: Annotated[NonNegative, Field(description="electrons a pixel that come without light")] = 0.0
    hot_pixels: Annotated[Fraction, Field(description="share of pixels that are always full")] = 0.0
    full_well_e: Annotated[Positive | None, Field(description="electrons at which a pixel is full")] = None
    bit_depth: Annotated[
        int | None, Field(strict=True, ge=1, le=16, description="bits of a count; needs the full well")
    ] = None
    frames: Annotated[int, Field(strict=True, ge=1, description="of a film (metafab.camera.film)")] = 1
    frame_interval_s: Annotated[Positive, Field(description="from the start of one frame to that of the next")] = 0.04
    exposure_s: Annotated[NonNegative, Field(description="what moves in this time is blurred; 0 for a flash")] = 0.0
    background: Annotated[Fraction, Field(description="brightness behind all objects")] = 0.0
    field_px: Annotated[
        tuple[Annotated[int, Field(strict=True, ge=8)], Annotated[int, Field(strict=True, ge=8)]],
        Field(description="rows and columns of each image"),
    ] = (128, 128)
    seed: Annotated[int, Field(strict=True, ge=0)] = 1

    @model_validator(mode="after")
    def _counts(self) -> Scene:
        if self.full_well_e is None and (self.bit_depth is not None or self.hot_pixels > 0.0):
            raise ValueError("`bit_depth` and `hot_pixels` need `full_well_e`")
        return self

    @model_validator(mode="after")
    def _times(self) -> Scene:
        if self.exposure_s > self.frame_interval_s:
            raise ValueError("`exposure_s` must not be longer than `frame_interval_s`")
        end_s = (self.frames - 1) * self.frame_interval_s + self.exposure_s
        if any(piece.depth_m + end_s * piece.velocity_m_per_s[2] <= 0.0 for piece in self.objects):
            raise ValueError("`velocity_m_per_s` takes an object through the lens before the last frame's end")
        return self
