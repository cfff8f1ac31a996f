"""The PSF pair: pictures over depth and field, orientation, peak, modulation transfer, aberrations over the field."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from metafab.core.conventions import POLARISATIONS, FloatArray, Polarisation
from metafab.core.figures import AberrationFigures, FocusFigures
from metafab.optics.point_spread import Psf
from metafab.report.style import (
    CONTRAST_MAP,
    IDEAL,
    INK,
    LIGHT_MAP,
    POLARISATION_COLOUR,
    X_COLOUR,
    bare,
    depth_text,
    depth_unit,
    dress,
    finished,
    legend,
    picture,
    scale_bar,
    show_map,
)
from metafab.steps.optics.merit import SpaceVarianceFigures

_MOST_COLUMNS = 8


def shown_depths(psf: Psf) -> NDArray[np.int64]:
    """Indices, shape (n,), of the depths that :func:`pair_over_depth` draws: all, or eight spread over the stack."""
    count = psf.depth_m.size
    return np.unique(np.linspace(0, count - 1, min(count, _MOST_COLUMNS)).round().astype(np.int64))


def lit_half_px(psf: Psf) -> int:
    """Half side of the square about the image point that holds all pixels above 4 % of the brightest."""
    _, _, n_y, n_x = psf.psf.shape
    row, column = np.nonzero(psf.psf.max(axis=(0, 1)) > 0.04 * psf.psf.max())
    most: int = (min(n_y, n_x) - 1) // 2
    if row.size == 0:
        return most
    reach = max(int(np.abs(row - n_y // 2).max()), int(np.abs(column - n_x // 2).max()))
    return min(most, reach + 2)


def pair_over_depth(psf: Psf, axes: Axes, *, arrows: bool = True) -> Axes:
    """Draw both PSFs over depth on one scale (Fig. 2h of Shen 2023).

    Crosshairs mark the geometric image point; arrows point from it to the maximum.
    """
    chosen, half = shown_depths(psf), lit_half_px(psf)
    _, _, n_y, n_x = psf.psf.shape
    reach = (half + 0.5) * psf.pixel_um
    step = 2.0 * reach / 0.96
    brightest = float(psf.psf.max()) or 1.0
    bare(axes)
    for row, polarisation in enumerate(POLARISATIONS):
        y = (0.5 - row) * step
        for column, depth in enumerate(chosen):
            x = (column + 0.5) * step
            extent = (x - reach, x + reach, y - reach, y + reach)
            shown = psf.psf[row, depth, n_y // 2 - half : n_y // 2 + half + 1, n_x // 2 - half : n_x // 2 + half + 1]
            show_map(axes, shown, extent, cmap=LIGHT_MAP, vmin=0.0, vmax=brightest, interpolation="bilinear")
            for along, across in (((x - reach, x + reach), (y, y)), ((x, x), (y - reach, y + reach))):
                axes.plot(along, across, color="#ffffff", linewidth=0.6, alpha=0.55, solid_capstyle="butt")
            peak_y, peak_x = np.unravel_index(int(np.argmax(shown)), shown.shape)
            tip = (x + (peak_x - half) * psf.pixel_um, y + (peak_y - half) * psf.pixel_um)
            arrow = {"arrowstyle": "->", "color": "#7fe3c4", "linewidth": 1.3, "shrinkA": 0, "shrinkB": 0}
            if arrows:
                axes.annotate("", tip, (x, y), arrowprops=arrow)
            if row == 0 and psf.depth_m.size > 1:
                above: dict[str, Any] = {"textcoords": "offset points", "fontsize": 9.5, "color": INK}
                axes.annotate(depth_text(float(psf.depth_m[depth])), (x - reach, y + reach), (0, 7), **above)
        name: dict[str, Any] = {"fontsize": 9, "color": POLARISATION_COLOUR[polarisation], "rotation": 90}
        axes.text(-0.06 * step, y, f"PSF of {polarisation}", ha="right", va="center", **name)
    scale_bar(axes, (0.02 * step, 0.98 * step, 0.02 * step, 0.98 * step), text_above=True)
    axes.set(xlim=(0.0, chosen.size * step), ylim=(-step, step), aspect="equal", anchor="NW")
    return axes


def orientation(psf: Psf, axes: Axes, ideal: Psf | None = None) -> Axes:
    """Draw the unwrapped orientation of the pair over depth (Fig. 2g of Shen 2023), and that of the target phases."""
    scale, unit = depth_unit(psf.depth_m)
    if ideal is not None:
        line: dict[str, Any] = {"color": IDEAL, "linewidth": 3.5, "alpha": 0.6, "label": "target phases"}
        axes.plot(scale * ideal.depth_m, _unwrapped(ideal), **line)
    line = {"color": X_COLOUR, "linewidth": 1.4, "marker": "o", "markersize": 4, "label": ideal and "written file"}
    axes.plot(scale * psf.depth_m, _unwrapped(psf), **line)
    dress(axes, f"object depth / {unit}", "orientation φ / °", "Orientation of the pair over depth")
    # A range of at least two degrees, so that a pair without rotation is a level line.
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, 0.5 * (low + high) - 1.0), max(high, 0.5 * (low + high) + 1.0))
    axes.yaxis.set_major_locator(MaxNLocator(6, integer=True))  # labels of tenths would run into the axis label
    return finished(axes)


def peak(psf: Psf, axes: Axes, ideal: Psf | None = None, source: str = "written file") -> Axes:
    """Draw the peak irradiance of both PSFs over depth, and that of the target phases."""
    scale, unit = depth_unit(psf.depth_m)
    for row, polarisation in enumerate(POLARISATIONS):
        colour = POLARISATION_COLOUR[polarisation]
        line: dict[str, Any] = {"color": colour, "linewidth": 1.4, "marker": "o", "markersize": 4}
        values = psf.psf[row].max(axis=(1, 2))
        axes.plot(scale * psf.depth_m, values, label=f"{polarisation}, {source}", **line)
        if ideal is not None:
            values = ideal.psf[row].max(axis=(1, 2))
            axes.plot(scale * ideal.depth_m, values, color=colour, linewidth=1.0, linestyle=(0, (4, 3)), alpha=0.8)
    if ideal is not None:
        axes.plot([], [], color=INK, linewidth=1.0, linestyle=(0, (4, 3)), label="target phases")
    dress(axes, f"object depth / {unit}", "peak irradiance / µm⁻²", "Peak, per unit power at the aperture")
    highest = max(float(stack.psf.max()) for stack in (psf, *(() if ideal is None else (ideal,))))
    axes.set_ylim(0.0, 1.08 * highest)
    return finished(axes)


def over_field(psf: Psf, axes: Axes, polarisation: Polarisation) -> Axes:
    """Draw one PSF over the field of view at the middle depth, each about its image point, on one scale.

    ValueError if ``psf`` holds no field.
    """
    if psf.field is None:
        raise ValueError("`psf`: expected one with a field of view, got the axis alone")
    half = lit_half_px(psf)
    pictures = psf.field.psf[POLARISATIONS.index(polarisation), psf.depth_m.size // 2]
    rows, columns, n_y, n_x = pictures.shape
    lit = pictures[:, :, n_y // 2 - half : n_y // 2 + half + 1, n_x // 2 - half : n_x // 2 + half + 1]
    side = 2 * half + 1
    mosaic = lit.transpose(0, 2, 1, 3).reshape(rows * side, columns * side)
    show_map(axes, mosaic, (0.0, columns, 0.0, rows), cmap=LIGHT_MAP, vmin=0.0, interpolation="bilinear")
    title = f"PSF of {polarisation} over the field"
    if psf.depth_m.size > 1:
        title += f", {depth_text(float(psf.depth_m[psf.depth_m.size // 2]))}"
    dress(axes, "object direction x / °", "object direction y / °", title, POLARISATION_COLOUR[polarisation])
    axes.set_xticks(np.arange(columns) + 0.5, _degrees(psf.field.tangent_x))
    axes.set_yticks(np.arange(rows) + 0.5, _degrees(psf.field.tangent_y))
    for line in range(1, columns):
        axes.axvline(line, color="#ffffff", linewidth=0.5, alpha=0.35)
    for line in range(1, rows):
        axes.axhline(line, color="#ffffff", linewidth=0.5, alpha=0.35)
    return axes


def focus_section(focus: FocusFigures, axes: Axes) -> Axes:
    """Draw the focus along x and y, and that of the ideal flat lens, relative to the maximum."""
    limit: dict[str, Any] = {"color": IDEAL, "linewidth": 3.5, "alpha": 0.6, "label": "ideal flat lens"}
    axes.plot(focus.offset_um, focus.section_limit, **limit)
    for along, section, colour, style in (
        ("x", focus.section_x, X_COLOUR, "-"),
        ("y", focus.section_y, POLARISATION_COLOUR["y"], "--"),
    ):
        axes.plot(focus.offset_um, section, color=colour, linestyle=style, linewidth=1.4, label=f"along {along}")
    dress(axes, "distance from the maximum / µm", "electric energy density", "cross-sections of the focus")
    axes.set_ylim(0.0, 1.05)
    return finished(axes)


def wavefront_map(front: AberrationFigures, axes: Axes) -> Axes:
    """Draw the wavefront error over the aperture, on a symmetric scale."""
    x, y = front.x_um, front.y_um
    half_x, half_y = 0.5 * float(x[1] - x[0]), 0.5 * float(y[1] - y[0])
    extent = float(x[0]) - half_x, float(x[-1]) + half_x, float(y[0]) - half_y, float(y[-1]) + half_y
    largest = float(np.nanmax(np.abs(front.opd_waves)))
    scale: dict[str, Any] = {"cmap": CONTRAST_MAP, "vmin": -largest, "vmax": largest, "bar": INK}
    title, ink = f"{front.polarisation} polarised", POLARISATION_COLOUR[front.polarisation]
    return picture(axes, front.opd_waves, extent, "wavefront error / waves", title, title_ink=ink, **scale)


def modulation(
    frequency_per_mm: FloatArray, curves: Mapping[str, FloatArray], axes: Axes, lens: Sequence[FloatArray] = ()
) -> Axes:
    """Draw the modulation transfer over spatial frequency on the sensor, shape (n,).

    ``curves`` hold the transfer, shape (n,), by name, ``lens`` that of an ideal lens at the same depths.
    """
    for transfer, style in zip(lens, ("-", "--", ":"), strict=False):
        label = "ideal lens of this aperture" if style == "-" else None
        axes.plot(frequency_per_mm, transfer, color=IDEAL, linewidth=1.2, linestyle=style, label=label)
    for (name, transfer), style in zip(curves.items(), ("-", "--", ":"), strict=False):
        axes.plot(frequency_per_mm, transfer, color=X_COLOUR, linewidth=1.5, linestyle=style, label=name)
    dress(axes, "spatial frequency / mm⁻¹", "modulation transfer", "MTF, x polarised, mean over directions")
    axes.set(xlim=(0.0, float(frequency_per_mm[-1])), ylim=(0.0, 1.0))
    return finished(axes)


def depth_bias(space: SpaceVarianceFigures, axes: Axes) -> Axes:
    """Draw the depth bias along the split for both polarisations: apparent in the PSFs, and from defocus alone."""
    row = space.tangent_y.size // 2
    degrees = np.degrees(np.arctan(space.tangent_x))
    for index, p in enumerate(POLARISATIONS):
        colour = POLARISATION_COLOUR[p]
        bias, defocus = space.seen_bias_dioptre[index, row], space.defocus_dioptre[index, row]
        axes.plot(degrees, bias, color=colour, marker="o", markersize=4, linewidth=1.4, label=f"{p}, from the PSFs")
        axes.plot(degrees, defocus, color=colour, linewidth=1.0, linestyle=(0, (4, 3)), alpha=0.8)
    axes.plot([], [], color=INK, linewidth=1.0, linestyle=(0, (4, 3)), label="defocus alone")
    dress(axes, "object direction along the split / °", "vergence bias / dioptre", "Depth bias over the field")
    return finished(axes)


def distortion(space: SpaceVarianceFigures, axes: Axes) -> Axes:
    """Draw the shift of both image points from those of a pinhole, as arrows over the field."""
    x, y = np.meshgrid(np.degrees(np.arctan(space.tangent_x)), np.degrees(np.arctan(space.tangent_y)))
    shift = space.distortion_um
    largest = float(np.hypot(shift[..., 0], shift[..., 1]).max()) or 1.0
    arrows: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "width": 0.006}
    arrows["scale"] = largest / max(float(np.ptp(x)), 1e-9) * 4.0
    for index, p in enumerate(POLARISATIONS):
        axes.quiver(x, y, shift[index, ..., 0], shift[index, ..., 1], color=POLARISATION_COLOUR[p], label=p, **arrows)
    axes.margins(0.14)
    title = f"Distortion, at most {largest:.3g} µm"
    dress(axes, "object direction x / °", "object direction y / °", title)
    # Above the axes: inside, the legend would cover arrows.
    legend(axes, loc="lower right", bbox_to_anchor=(1.04, 0.985), ncols=2, columnspacing=0.9, handlelength=1.0)
    return axes


def _degrees(tangents: FloatArray) -> list[str]:
    return [f"{angle:.2g}".replace("-", "−") for angle in np.degrees(np.arctan(tangents))]


def _unwrapped(psf: Psf) -> np.ndarray:
    return np.unwrap(psf.phi_deg, period=360.0)
