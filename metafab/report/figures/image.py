"""Raw frame and decoded 4D image (Fig. 3 of Shen 2023)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm

from metafab.camera.frames.frame import RawFrame
from metafab.core.conventions import FloatArray, Polarisation
from metafab.decode.image import Image4D
from metafab.report.accounts import DepthPairs
from metafab.report.style import (
    CONTRAST_MAP,
    DEPTH_MAP,
    IDEAL,
    MUTED,
    POLARISATION_COLOUR,
    SHARE_MAP,
    X_COLOUR,
    Extent,
    colour_bar,
    depth_unit,
    dress,
    show_map,
)


def _few_ticks(axes: Axes) -> Axes:
    """Set few ticks along x, as coordinates of four digits need room."""
    axes.locator_params(axis="x", nbins=5)
    return axes


def raw_frame(raw: RawFrame, axes: Axes) -> Axes:
    """Draw the frame of the sensor: the images of y and x polarisation side by side."""
    extent = extent_um(raw.frame.shape, raw.origin_um, raw.pixel_um)
    top = float(np.nanpercentile(raw.frame, 99.8)) or 1.0
    image = show_map(axes, raw.frame, extent, cmap="gray", vmin=0.0, vmax=top)
    colour_bar(image, axes, "electrons")
    return dress(axes, "x on the sensor / µm", "y / µm", "Raw frame")


def intensity(decoded: Image4D, axes: Axes, polarisation: Polarisation, top: float | None = None) -> Axes:
    """Draw the all-in-focus intensity of one polarisation, on a scale up to ``top`` electrons."""
    values = decoded.intensity_x if polarisation == "x" else decoded.intensity_y
    image = show_map(axes, values, _extent(decoded), cmap="gray", vmin=0.0, vmax=top or _top(values))
    colour_bar(image, axes, "electrons")
    return _few_ticks(
        dress(axes, "x / µm", "y / µm", f"I_{polarisation}, all in focus", POLARISATION_COLOUR[polarisation])
    )


def contrast(decoded: Image4D, axes: Axes) -> Axes:
    """Draw I_x / I_y on a logarithmic scale about 1."""
    reach = contrast_reach(decoded)
    norm = LogNorm(1.0 / reach, reach)
    image = show_map(axes, decoded.contrast, _extent(decoded), cmap=CONTRAST_MAP, norm=norm)
    ticks = [tick for tick in (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0) if 1.0 / reach <= tick <= reach]
    colour_bar(image, axes, "I_x / I_y", ticks, [f"{tick:g}" for tick in ticks])
    return _few_ticks(dress(axes, "x / µm", "y / µm", "Polarisation contrast"))


def depth(decoded: Image4D, axes: Axes) -> Axes:
    """Draw the depth of every decoded pixel; pixels without depth stay blank."""
    scale, unit = depth_unit(decoded.depth_m)
    image = show_map(axes, scale * decoded.depth_m, _extent(decoded), cmap=DEPTH_MAP)
    colour_bar(image, axes, f"depth / {unit}")
    return _few_ticks(dress(axes, "x / µm", "y / µm", "Depth"))


def confidence(decoded: Image4D, axes: Axes) -> Axes:
    """Draw the confidence in the depth of each pixel, 0 to 1; 0 without depth."""
    image = show_map(axes, decoded.confidence, _extent(decoded), cmap=SHARE_MAP, vmin=0.0, vmax=1.0)
    colour_bar(image, axes, "confidence")
    return _few_ticks(dress(axes, "x / µm", "y / µm", "Confidence"))


def depth_against_truth(pairs: DepthPairs, axes: Axes) -> Axes:
    """Draw decoded against true depth, a point for each segment (Fig. 3f of Shen 2023); an error of 0 has no bar."""
    scale, unit = depth_unit(pairs.true_m)
    true, decoded, error = scale * pairs.true_m, scale * pairs.decoded_m, scale * pairs.error_m
    low, high = (float(f([*true, *decoded])) for f in (min, max))
    pad = 0.06 * (high - low) or 0.05 * high
    ends = (low - pad, high + pad)
    axes.plot(ends, ends, color=IDEAL, linewidth=3.0, alpha=0.5)
    axes.errorbar(true, decoded, yerr=error, fmt="o", markersize=5, color=X_COLOUR, elinewidth=1.0, capsize=2)
    dress(axes, f"true depth / {unit}", f"decoded depth / {unit}", "Depth against truth")
    axes.set(xlim=ends, ylim=ends, aspect="equal")
    axes.grid(color=MUTED, linewidth=0.4, alpha=0.3)
    return axes


def contrast_reach(decoded: Image4D) -> float:
    """Upper end of the contrast scale, from 2 to 10: 99 % of the ratios, or their inverse, lie below."""
    finite = decoded.contrast[np.isfinite(decoded.contrast) & (decoded.contrast > 0.0)]
    if not finite.size:
        return 2.0
    return float(np.clip(np.exp(np.percentile(np.abs(np.log(finite)), 99.0)), 2.0, 10.0))


def extent_um(shape: tuple[int, ...], origin_um: tuple[float, float], pixel_um: float) -> Extent:
    """(left, right, low, high) of an image whose pixel [0, 0] is centred on ``origin_um``."""
    left, low = origin_um[0] - 0.5 * pixel_um, origin_um[1] - 0.5 * pixel_um
    return (left, left + shape[1] * pixel_um, low, low + shape[0] * pixel_um)


def _extent(decoded: Image4D) -> Extent:
    return extent_um(decoded.depth_m.shape, decoded.origin_um, decoded.pixel_um)


def _top(values: FloatArray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.percentile(finite, 99.8)) if finite.size else 1.0
