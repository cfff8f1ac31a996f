"""Cells that no stretched grid fits: curved outlines and crosses, sloped walls, films and caps.

They stand on a plain grid of cubes, and Meep averages the permittivity of the pixels that a wall crosses (Farjadpour et
al., Opt. Lett. 31, 2972, 2006), which keeps the error of second order. A sloped wall becomes one step for each pixel of
the height, so that its error is of second order in the pixel as well.
"""

from __future__ import annotations

import math

import numpy as np

from metafab.cell.meep.grid import Plan, permittivity, smoothed_plan
from metafab.cell.meep.protocol import Block
from metafab.cell.pillar import PillarCell, Slice
from metafab.cell.rcwa.symmetry import layers_of
from metafab.core.conventions import FloatArray, Polarisation
from metafab.core.errors import InputError

#: Vertices of the polygon that replaces an ellipse or four rounded corners. It has the area of the curve, and is at
#: most 3e-4 of the radius away from it.
_VERTICES = 96
#: Fewest and most pixels of the x period of the coarsest grid.
_FEWEST, _MOST = 12, 40


def is_shaped(cell: PillarCell) -> bool:
    """Whether a cell needs the plain grid."""
    return cell.is_shaped or cell.is_sloped or bool(cell.under or cell.over)


def base_pixels(cell: PillarCell) -> tuple[int, int]:
    """Pixels of the period along x and y on the coarsest grid: even numbers, of one size along both.

    Raises:
        InputError: no such grid of at most 40 pixels.
    """
    p_x, p_y = cell.period_nm
    for n_x in range(_FEWEST, _MOST + 1, 2):
        n_y = n_x * p_y / p_x
        if abs(n_y - round(n_y)) < 1e-9 * n_y and round(n_y) % 2 == 0 and n_y >= _FEWEST:
            return n_x, round(n_y)
    expected = f"two lengths whose ratio is that of even numbers up to {_MOST} for the solver meep"
    raise InputError.single("cell", "period_nm", expected, f"{p_x:g} x {p_y:g} nm", "round them, or solve with rcwa")


def shaped_plan(
    cell: PillarCell, polarisation: Polarisation, member: int, *, decay: float, longest_time: float
) -> Plan:
    """FDTD run of one polarisation on the grid with ``member`` times the pixels of the coarsest.

    Errors and the last two arguments as in :func:`metafab.cell.meep.grid.plan`.
    """
    n_x, n_y = (member * pixels for pixels in base_pixels(cell))
    pixel = cell.period_nm[0] * 1e-3 / n_x
    layers = layers_of(cell, max(1, round(cell.height_nm * 1e-3 / pixel)))
    return smoothed_plan(
        cell,
        polarisation,
        (n_x, n_y),
        pixel,
        1e-3 * sum(layer.height_nm for layer in layers),
        lambda start, beyond: _blocks(cell, layers, start, beyond),
        components=(polarisation,),
        decay=decay,
        longest_time=longest_time,
    )


def _blocks(cell: PillarCell, layers: tuple[Slice, ...], start: float, beyond: float) -> tuple[Block, ...]:
    """Half spaces and layers, which begin at z = ``start``.

    The lowest layer of the pillar continues into the medium below, which then covers its foot: at the rim Meep then
    meets two materials and one plane, not three materials.
    """
    upwards = cell.side == "substrate"
    edges = start + 1e-3 * np.cumsum([0.0, *(layer.height_nm for layer in (layers if upwards else layers[::-1]))])
    spans = list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))[:: 1 if upwards else -1]
    films = len(cell.under)
    ambient = (cell.n_ambient, cell.n_ambient)
    blocks = [_slab(beyond, start, beyond, ambient)]
    for number in (*range(films, len(layers)), *range(films)):
        layer, (low, high) = layers[number], spans[number]
        if number < films or layer.n_around != cell.n_ambient:
            blocks.append(_slab(beyond, low, high, (layer.n_around, layer.n_around)))
        if number == films:
            low, high = (low - beyond, high) if upwards else (low, high + beyond)
        if layer.n_inside != layer.n_around and layer.width_nm and layer.length_nm:
            blocks += pillar_blocks(cell, layer, (low, high))
    end = float(edges[-1])
    blocks.append(_slab(beyond, -beyond, start, cell.n_in) if upwards else _slab(beyond, end, beyond, cell.n_out))
    return tuple(blocks)


def _slab(beyond: float, low: float, high: float, n: tuple[complex, complex]) -> Block:
    return Block((-beyond, -beyond, low), (beyond, beyond, high), permittivity(n))


def pillar_blocks(
    cell: PillarCell, layer: Slice, span: tuple[float, float], at: tuple[float, float] = (0.0, 0.0)
) -> list[Block]:
    """The inside of a layer as a prism, or as boxes.

    Args:
        cell: outline of the pillar.
        layer: sizes and indices of the layer.
        span: z where it begins and ends, um.
        at: (x, y) of the pillar, um.
    """
    assert layer.width_nm is not None and layer.length_nm is not None  # layers_of states both
    half_x, half_y = 5e-4 * layer.width_nm, 5e-4 * layer.length_nm
    epsilon = permittivity((layer.n_inside, layer.n_inside))
    is_curved = cell.shape in {"ellipse", "ring"} or cell.corner_radius_nm > 0.0
    arms = {(half_x, half_y), (half_y, half_x)} if cell.shape == "cross" else {(half_x, half_y)}
    parts = [(half_x, half_y, epsilon) for half_x, half_y in sorted(arms)]
    # Both sides of a ring's sloped wall recede alike and may close the hole. Its block comes after the pillar's.
    half_hole = 5e-4 * (cell.hole_nm + cell.width_nm) - half_x
    if cell.shape == "ring" and half_hole > 0.0:
        parts.append((half_hole, half_hole, permittivity((layer.n_around, layer.n_around))))
    return [
        Block(
            (at[0] - x, at[1] - y, span[0]),
            (at[0] + x, at[1] + y, span[1]),
            eps,
            outline=tuple((at[0] + u, at[1] + v) for u, v in _curve(cell, x, y).tolist()) if is_curved else (),
        )
        for x, y, eps in parts
    ]


def _curve(cell: PillarCell, half_x: float, half_y: float) -> FloatArray:
    """Vertices of an ellipse or of a rectangle with rounded corners, shape (n, 2), um."""
    angle = 2.0 * np.pi * (np.arange(_VERTICES) + 0.5) / _VERTICES
    # The polygon of n vertices has n sin(2 pi / n) / (2 pi) of the area of the curve around it.
    wider = 1.0 / math.sqrt(_VERTICES * math.sin(2.0 * math.pi / _VERTICES) / (2.0 * math.pi))
    direction = wider * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    if cell.shape in {"ellipse", "ring"}:
        return direction * (half_x, half_y)
    radius = min(1e-3 * cell.corner_radius_nm, half_x, half_y)
    return radius * direction + np.sign(direction) * (half_x - radius, half_y - radius)
