"""The blurs of a PSF pair, each computed once for all scenes that are photographed through it."""

from __future__ import annotations

from dataclasses import dataclass, field

from metafab.camera.kernels import PairKernels
from metafab.camera.rendering.blur import FieldBlur
from metafab.camera.rendering.depth_blur import DepthBlur

#: Blurs that are kept from frame to frame; one of the lens of Shen 2023 takes a megabyte.
_MOST_BLURS = 256


@dataclass(frozen=True)
class Blurs:
    """Blurs of single depths and of surfaces whose depth changes from pixel to pixel."""

    kernels: PairKernels  #: The PSF pair.
    #: Of both polarisations, by depth.
    of_depths: dict[float, tuple[FieldBlur, FieldBlur]] = field(default_factory=dict)
    of_surfaces: dict[int, DepthBlur] = field(default_factory=dict)  #: By polarisation.

    def at_depth(self, depth_m: float, polarisation: int) -> FieldBlur:
        """Return the blur of one depth and polarisation (0 for x, 1 for y)."""
        if depth_m not in self.of_depths:
            self.of_depths[depth_m] = FieldBlur.at_depth(self.kernels, depth_m)
        return self.of_depths[depth_m][polarisation]

    def over_depths(self, polarisation: int) -> DepthBlur:
        """Return the blur of surfaces of any depths."""
        if polarisation not in self.of_surfaces:
            self.of_surfaces[polarisation] = DepthBlur.of(self.kernels, polarisation)
        return self.of_surfaces[polarisation]

    def drop_many(self) -> None:
        """Delete the blurs of past depths if they are many."""
        if len(self.of_depths) > _MOST_BLURS:
            self.of_depths.clear()
