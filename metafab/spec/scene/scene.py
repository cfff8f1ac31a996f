"""Scene: opaque objects with depth, texture and polarisation; photons and noise of the sensor."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from metafab.spec.fields import Checked, Fraction, NonNegative, Positive, Real, spec
from metafab.spec.scene.rgbd import Rgbd


@spec()
class SceneObject(Checked):
    """An opaque surface: flat, tilted or bulging; nearer objects occlude farther ones.

    Centre and size are tangents of directions (x/z, y/z), so the image of an object does not move when its depth
    changes. At u, v from -1/2 to 1/2 across the object, depth / depth_m = 1 + tilt . (u, v) + 4 bulge . (u^2, v^2).
    """

    depth_m: Positive  #: Depth at the object's centre.
    centre: tuple[Real, Real] = (0.0, 0.0)  #: Direction of the centre: x/z and y/z.
    size: tuple[Positive, Positive] = (0.01, 0.01)  #: Extent in x/z and y/z.
    outline: Literal["rectangle", "ellipse"] = "rectangle"  #: Shape of the outline.
    tilt: tuple[Real, Real] = (0.0, 0.0)  #: Relative change of depth across the object in x and y.
    #: Relative change of depth from the centre to the edges in x and y; positive for a ball.
    bulge: tuple[Real, Real] = (0.0, 0.0)
    brightness: Positive = 1.0  #: Brightness relative to other objects.
    polarisation_contrast: Positive = 1.0  #: I_x / I_y.
    #: (S1, S2, S3) / S0 for `metafab stokes`; x and y polarisation as by the contrast without the key.
    stokes: tuple[Real, Real, Real] | None = None
    texture: Literal["uniform", "fractal", "checker", "image"] = "fractal"  #: Texture of the surface.
    texture_contrast: Fraction = 0.25  #: Rms of the texture over its mean.
    #: Velocity along x, y and away from the lens; the first frame starts in place.
    velocity_m_per_s: tuple[Real, Real, Real] = (0.0, 0.0, 0.0)
    texture_file: Path | None = None  #: Picture of an object with `texture = "image"`.

    def _faults(self) -> Iterator[str]:
        if (self.texture == "image") != (self.texture_file is not None):
            yield "`texture_file` belongs to texture = 'image', and only to it"
        if 0.5 * sum(map(abs, self.tilt)) + sum(map(abs, self.bulge)) > 0.5:
            yield "`tilt` and `bulge` must change the depth by at most half of itself: |tilt| / 2 + |bulge|"
        if self.stokes is not None and math.hypot(*self.stokes) > 1.0 + 1e-9:
            yield "`stokes` must not be longer than 1: light cannot be more than fully polarised"

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


@spec()
class Scene(Checked):
    """A scene (table ``[scene]`` of a design, or a file of its own)."""

    objects: tuple[SceneObject, ...] = ()  #: Opaque surfaces; nearer ones hide farther ones.
    rgbd: Rgbd | None = None  #: Picture with its depth, in place of objects.
    photons_per_pixel: Positive = 3000.0  #: Photons on an axial pixel at brightness 1, mean of both images.
    quantum_efficiency: Annotated[float, Field(strict=True, gt=0.0, le=1.0)] = 1.0  #: Electrons per photon.
    vignetting: Literal["natural", "none"] = "natural"  #: Natural: the fourth power of the field angle's cosine.
    read_noise_e: NonNegative = 2.0  #: Read noise, rms.
    dark_e: NonNegative = 0.0  #: Dark electrons per pixel and frame.
    dark_current_e_per_s: NonNegative = 0.0  #: Dark electrons per pixel and second.
    response_rms: Fraction = 0.0  #: Fixed-pattern noise: rms of the pixels' responses over their mean.
    hot_pixels: Fraction = 0.0  #: Share of pixels that are always saturated.
    full_well_e: Positive | None = None  #: Full-well capacity.
    bit_depth: Annotated[int | None, Field(strict=True, ge=1, le=16)] = None  #: Bits of a count; needs the full well.
    frames: Annotated[int, Field(strict=True, ge=1)] = 1  #: Number of frames of a film.
    frame_interval_s: Positive = 0.04  #: Time from the start of one frame to that of the next.
    exposure_s: NonNegative = 0.0  #: Exposure time; 0 for a flash.
    row_time_s: NonNegative = 0.0  #: Rolling shutter: delay of each row after the row below; 0 for a global shutter.
    background: Fraction = 0.0  #: Brightness behind all objects.
    #: Rows and columns of each image.
    field_px: tuple[Annotated[int, Field(strict=True, ge=8)], Annotated[int, Field(strict=True, ge=8)]] = (128, 128)
    seed: Annotated[int, Field(strict=True, ge=0)] = 1  #: Seed of texture and noise.

    def _faults(self) -> Iterator[str]:
        if bool(self.objects) == (self.rgbd is not None):
            yield "a scene must have `objects` or a picture with its depth (`rgbd`), one of both"
        if self.full_well_e is None and (self.bit_depth is not None or self.hot_pixels > 0.0):
            yield "`bit_depth` and `hot_pixels` need `full_well_e`"
        for name, used_s in (("exposure_s", self.exposure_s), ("row_time_s", self.row_time_s * self.field_px[0])):
            if used_s > self.frame_interval_s:
                yield f"a frame must last at most `frame_interval_s`, but its `{name}` takes {used_s:g} s"
        if any(piece.depth_m + self.end_s * piece.velocity_m_per_s[2] <= 0.0 for piece in self.objects):
            yield "`velocity_m_per_s` takes an object through the lens before the last frame's end"

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
        if self.rgbd is not None:
            depth_m = self.rgbd.depths_m()
            return float(np.nanmin(depth_m)), float(np.nanmax(depth_m))
        depths = set()
        for piece in self.objects:
            for time_s in (0.0, self.end_s):
                centre_m = piece.depth_m + piece.velocity_m_per_s[2] * time_s
                depths |= {centre_m * (1.0 + relative) for relative in piece.relative_depths}
        return tuple(sorted(depths))
