"""Scene: opaque objects with depth, texture and polarisation; photons and noise of the sensor."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from metafab.spec.fields import CONFIG, Fraction, NonNegative, Positive, Real


@dataclass(frozen=True, config=CONFIG)
class SceneObject:
    """An opaque surface: flat, tilted or bulging; nearer objects occlude farther ones.

    Centre and size are tangents of directions (x/z, y/z), so the image of an object does not move when its depth
    changes. ``depth_m`` is the depth at the centre; at u, v from -1/2 to 1/2 across the object,
    depth / depth_m = 1 + tilt . (u, v) + 4 bulge . (u^2, v^2).
    """

    depth_m: Positive
    centre: tuple[Real, Real] = (0.0, 0.0)
    size: tuple[Positive, Positive] = (0.01, 0.01)
    outline: Literal["rectangle", "ellipse"] = "rectangle"
    tilt: Annotated[
        tuple[Real, Real], Field(description="change of depth over depth at the centre, along the full size in x and y")
    ] = (0.0, 0.0)
    bulge: Annotated[
        tuple[Real, Real],
        Field(description="change of depth over depth from the centre to the edges in x and y; a ball's is positive"),
    ] = (0.0, 0.0)
    brightness: Positive = 1.0
    polarisation_contrast: Annotated[Positive, Field(description="I_x / I_y")] = 1.0
    stokes: Annotated[
        tuple[Real, Real, Real] | None,
        Field(description="(S1, S2, S3) / S0 for `metafab stokes`; x and y polarisation as by the contrast if omitted"),
    ] = None
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
    def _shape(self) -> SceneObject:
        if 0.5 * sum(map(abs, self.tilt)) + sum(map(abs, self.bulge)) > 0.5:
            raise ValueError("`tilt` and `bulge` must change the depth by at most half of itself: |tilt| / 2 + |bulge|")
        return self

    @model_validator(mode="after")
    def _polarised(self) -> SceneObject:
        if self.stokes is not None and math.hypot(*self.stokes) > 1.0 + 1e-9:
            raise ValueError("`stokes` must not be longer than 1: light cannot be more than fully polarised")
        return self

    @property
    def stokes_vector(self) -> tuple[float, float, float]:
        """(S1, S2, S3) / S0."""
        ratio = self.polarisation_contrast
        return ((ratio - 1.0) / (ratio + 1.0), 0.0, 0.0) if self.stokes is None else self.stokes

    @property
    def moves(self) -> bool:
        """Whether the object moves."""
        return any(self.velocity_m_per_s)

    @property
    def relative_depths(self) -> tuple[float, float]:
        """Least and largest relative change of depth over the object's bounding box: (0, 0) for a flat one."""
        lowest = highest = 0.0
        for tilt, bulge in zip(self.tilt, self.bulge, strict=True):
            heights = [0.5 * tilt + bulge, -0.5 * tilt + bulge]
            if abs(tilt) < 4.0 * abs(bulge):  # the vertex lies on the object
                heights.append(-(tilt**2) / (16.0 * bulge))
            lowest, highest = lowest + min(heights), highest + max(heights)
        return lowest, highest


@dataclass(frozen=True, config=CONFIG)
class Scene:
    """A scene (table ``[scene]`` of a design, or a file of its own)."""

    objects: Annotated[tuple[SceneObject, ...], Field(min_length=1)]
    photons_per_pixel: Annotated[
        Positive,
        Field(description="photons on an axial pixel at brightness 1, mean of both images"),
    ] = 3000.0
    quantum_efficiency: Annotated[float, Field(strict=True, gt=0.0, le=1.0, description="electrons per photon")] = 1.0
    vignetting: Annotated[
        Literal["natural", "none"], Field(description="natural: the fourth power of the field angle's cosine")
    ] = "natural"
    read_noise_e: NonNegative = 2.0
    dark_e: Annotated[NonNegative, Field(description="dark electrons per pixel and frame")] = 0.0
    dark_current_e_per_s: Annotated[NonNegative, Field(description="dark electrons per pixel and second")] = 0.0
    response_rms: Annotated[
        Fraction, Field(description="fixed-pattern noise: rms of the pixels' responses over their mean")
    ] = 0.0
    hot_pixels: Annotated[Fraction, Field(description="share of pixels that are always saturated")] = 0.0
    full_well_e: Annotated[Positive | None, Field(description="full-well capacity, electrons")] = None
    bit_depth: Annotated[
        int | None, Field(strict=True, ge=1, le=16, description="bits of a count; needs the full well")
    ] = None
    frames: Annotated[int, Field(strict=True, ge=1, description="number of frames of a film")] = 1
    frame_interval_s: Annotated[Positive, Field(description="from the start of one frame to that of the next")] = 0.04
    exposure_s: Annotated[NonNegative, Field(description="exposure time; 0 for a flash")] = 0.0
    row_time_s: Annotated[
        NonNegative, Field(description="rolling shutter: delay of each row after the row below; 0 for a global shutter")
    ] = 0.0
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
        for name, used_s in (("exposure_s", self.exposure_s), ("row_time_s", self.row_time_s * self.field_px[0])):
            if used_s > self.frame_interval_s:
                raise ValueError(f"`{name}` must leave a frame no longer than `frame_interval_s`, got {used_s:g} s")
        if any(piece.depth_m + self.end_s * piece.velocity_m_per_s[2] <= 0.0 for piece in self.objects):
            raise ValueError("`velocity_m_per_s` takes an object through the lens before the last frame's end")
        return self

    @property
    def end_s(self) -> float:
        """End of the exposure of the last row of the last frame, from the start of the first frame, s."""
        return (self.frames - 1) * self.frame_interval_s + self.exposure_s + self.row_time_s * self.field_px[0]

    @property
    def dark_frame_e(self) -> float:
        """Mean dark electrons per pixel and frame."""
        return self.dark_e + self.dark_current_e_per_s * self.exposure_s

    @property
    def depths_m(self) -> tuple[float, ...]:
        """The nearest and farthest depth of every object in any of the frames, ascending, each once."""
        depths = set()
        for piece in self.objects:
            for time_s in (0.0, self.end_s):
                centre_m = piece.depth_m + piece.velocity_m_per_s[2] * time_s
                depths |= {centre_m * (1.0 + relative) for relative in piece.relative_depths}
        return tuple(sorted(depths))
