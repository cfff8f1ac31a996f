"""Raw frame and decoded 4D image (Fig. 3 of Shen 2023)."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from metafab.benchmark import DepthView
from metafab.camera.frames.frame import RawFrame
from metafab.core.conventions import FloatArray, Polarisation
from metafab.decode.image import Image4D
from metafab.report.accounts import DepthPairs
from metafab.report.style import (
    CONTRAST_MAP,
    DEPTH_MAP,
    IDEAL,
    INK,
    POLARISATION_COLOUR,
    SHARE_MAP,
    X_COLOUR,
    Extent,
    bare,
    colour_bar,
    depth_unit,
    dress,
    finished,
    map_with_bar,
    show_map,
)


def raw_frame(raw: RawFrame, axes: Axes) -> Axes:
    """Draw the frame of the sensor: the images of y and x polarisation side by side."""
    extent = extent_um(raw.frame.shape, raw.origin_um, raw.pixel_um)
    top = float(np.nanpercentile(raw.frame, 99.8)) or 1.0
    image = show_map(axes, raw.frame, extent, cmap="gray", vmin=0.0, vmax=top)
    colour_bar(image, axes, "electrons")
    return dress(axes, "x on the sensor / µm", "y / µm", "Raw frame")


def intensity(decoded: Image4D, axes: Axes, polarisation: Polarisation) -> Axes:
    """Draw the all-in-focus intensity of one polarisation."""
    values = decoded.intensity_x if polarisation == "x" else decoded.intensity_y
    scale: dict[str, Any] = {
        "cmap": "gray",
        "vmin": 0.0,
        "vmax": _top(values),
        "ink": POLARISATION_COLOUR[polarisation],
    }
    return _decoded_map(decoded, axes, values, "electrons", f"I_{polarisation}, all in focus", **scale)


def contrast(decoded: Image4D, axes: Axes) -> Axes:
    """Draw I_x / I_y on a logarithmic scale about 1."""
    reach = contrast_reach(decoded)
    ticks = [tick for tick in (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0) if 1.0 / reach <= tick <= reach]
    scale: dict[str, Any] = {
        "cmap": CONTRAST_MAP,
        "norm": LogNorm(1.0 / reach, reach),
        "ticks": (ticks, [f"{t:g}" for t in ticks]),
    }
    return _decoded_map(decoded, axes, decoded.contrast, "I_x / I_y", "Polarisation contrast", **scale)


def depth(decoded: Image4D, axes: Axes) -> Axes:
    """Draw the depth of every decoded pixel; pixels without depth stay blank."""
    scale, unit = depth_unit(decoded.depth_m)
    return _decoded_map(decoded, axes, scale * decoded.depth_m, f"depth / {unit}", "Depth", cmap=DEPTH_MAP)


def confidence(decoded: Image4D, axes: Axes) -> Axes:
    """Draw the confidence in the depth of each pixel, 0 to 1; 0 without depth."""
    scale: dict[str, Any] = {"cmap": SHARE_MAP, "vmin": 0.0, "vmax": 1.0}
    return _decoded_map(decoded, axes, decoded.confidence, "confidence", "Confidence", **scale)


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
    return finished(axes)


def depth_view(view: DepthView) -> Figure:
    """Draw a decoded frame beside its truth: light, depth, error of depth, confidence, and reliability diagram."""
    n_y, n_x = view.true_depth_m.shape
    map_in = 2.95 * n_y / n_x
    tall_in = 2.0 * (map_in + 0.5)
    figure = Figure(figsize=(15.0, tall_in))
    extent = (0.0, float(n_x), 0.0, float(n_y))
    scale, unit = depth_unit(view.true_depth_m)
    top = _top(view.true_intensity)
    true_depth, decoded_depth = scale * view.true_depth_m, scale * view.depth_m
    shades: dict[str, Any] = {"cmap": DEPTH_MAP, "vmin": np.nanmin(true_depth), "vmax": np.nanmax(true_depth)}
    light: dict[str, Any] = {"cmap": "gray", "vmin": 0.0, "vmax": top}
    errors: dict[str, Any] = {"cmap": CONTRAST_MAP, "vmin": -5.0, "vmax": 5.0}
    maps = (
        ("I_x, true", view.true_intensity, "electrons", light),
        ("I_x, decoded", view.intensity, "electrons", light),
        ("Confidence", view.confidence, "confidence", {"cmap": SHARE_MAP, "vmin": 0.0, "vmax": 1.0}),
        ("Depth, true", true_depth, f"depth / {unit}", shades),
        ("Depth, decoded", decoded_depth, f"depth / {unit}", shades),
        ("Error of depth", 100.0 * (view.depth_m / view.true_depth_m - 1.0), "error / %", errors),
    )
    for index, (title, values, label, options) in enumerate(maps):
        row, column = divmod(index, 3)
        bottom_in = 0.1 + (1 - row) * (map_in + 0.5)
        axes = figure.add_axes((0.01 + 0.265 * column, bottom_in / tall_in, 2.95 / 15.0, map_in / tall_in))
        map_with_bar(axes, values, extent, label, **options)
        bare(axes, title)
    axes = figure.add_axes((0.85, 0.5 - 1.0 / tall_in, 0.14, 2.1 / tall_in))
    axes.plot((0.0, 1.0), (0.0, 1.0), color=IDEAL, linewidth=3.0, alpha=0.5)
    axes.plot(view.bin_confidence, view.bin_right, "o-", color=X_COLOUR, markersize=4.5)
    dress(axes, "confidence", "share within 5 %", "Reliability")
    axes.set(xlim=(0.0, 1.0), ylim=(0.0, 1.03))
    return figure


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


def _decoded_map(
    decoded: Image4D,
    axes: Axes,
    values: FloatArray,
    label: str,
    title: str,
    *,
    ink: str = INK,
    **options: Any,
) -> Axes:
    """Draw a value of each pixel at its place on the sensor."""
    extent = extent_um(values.shape, decoded.origin_um, decoded.pixel_um)
    map_with_bar(axes, values, extent, label, **options)
    axes.locator_params(axis="x", nbins=5)  # Coordinates of four digits need room.
    return dress(axes, "x / µm", "y / µm", title, ink)


def _top(values: FloatArray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.percentile(finite, 99.8)) if finite.size else 1.0
