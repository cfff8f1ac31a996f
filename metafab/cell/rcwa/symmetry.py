"""Symmetry classes of a cell: layers, bases and outer waves of the fields that either polarisation excites.

A rectangle under light along z has four symmetry classes; x and y polarised light excite one each. For light that is
oblique in a mirror plane there are two classes. For any other direction there is one class with all coefficients.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice

from metafab.cell.pillar import PillarCell, Slice
from metafab.cell.rcwa.basis.axis import AxisBasis, AxisParity, outline_bases, parities, symmetric_axis
from metafab.cell.rcwa.basis.coordinates import Formulation, Matrix
from metafab.cell.rcwa.basis.transverse import TransverseBasis, transverse_basis
from metafab.cell.rcwa.layers.factorisation import layer_matrices
from metafab.cell.rcwa.layers.nested import Rectangles, nested_matrices, rectangles
from metafab.cell.rcwa.layers.staggered import staggered_matrices
from metafab.cell.rcwa.scattering.half_space import Waves, plane_waves, tensor_waves
from metafab.core.conventions import ComplexArray, Side
from metafab.core.errors import InputError


@dataclass(frozen=True)
class SymmetryClass:
    """Fields of one symmetry."""

    cell: PillarCell  #: The cell.
    #: For each layer from the substrate upwards, the bases of its rectangles; they differ in their outline.
    bases: tuple[tuple[TransverseBasis, ...], ...]
    layers: tuple[Slice, ...]  #: Content of each layer, with its sizes.
    n_in: complex  #: Index of the half space that the light comes from, for the polarisation of this class.
    n_out: complex  #: Index of the half space behind, for this polarisation.

    @property
    def basis(self) -> TransverseBasis:
        """Coefficients and wave numbers of all layers (with the overlap of the first outline)."""
        return self.bases[0][0]

    @cached_property
    def incident(self) -> ComplexArray:
        """Incident E_x = 1 and E_y = 1 as columns, shape (n, 2); zero if the class lacks that wave."""
        return self.basis.zero_order()

    def thickness_k0(self, index: int = 0) -> float:
        """Thickness of a layer times k0."""
        return self.cell.k0_per_nm * self.layers[index].height_nm

    def matrices(self, index: int = 0) -> tuple[Matrix, Matrix]:
        """P and Q of a layer in (TM, TE), each of shape (n, n)."""
        layer, bases, k0_per_nm = self.layers[index], self.bases[index], self.cell.k0_per_nm
        media = permittivity(layer.n_inside), permittivity(layer.n_around)
        if self.cell.is_staggered:
            return staggered_matrices(bases[0], bases[1], k0_per_nm, *media)
        if len(bases) > 1:
            return nested_matrices(bases, k0_per_nm, *media)
        return layer_matrices(bases[0], k0_per_nm, *media)

    def outer_waves(self) -> tuple[Waves, Waves]:
        """Plane waves of the half space that the light comes from, and of the half space behind."""
        return self._waves(self.cell.side, self.n_in), self._waves(self.cell.far_side, self.n_out)

    def _waves(self, side: Side, n: complex) -> Waves:
        tensor, k0_per_nm = self.cell.tensor(side), self.cell.k0_per_nm
        if tensor is None:
            return plane_waves(self.basis, k0_per_nm, permittivity(n))
        return tensor_waves(self.basis, k0_per_nm, tensor)


def permittivity(n: complex) -> complex:
    """Square of the index; a real number for a real index, so that real arithmetic follows."""
    return n * n if complex(n).imag else complex(n).real ** 2


def layers_of(cell: PillarCell, steps: int = 1) -> tuple[Slice, ...]:
    """Layers of the cell from the substrate upwards, each with its sizes; a sloped pillar becomes ``steps`` layers."""
    count = steps if cell.is_sloped else 1
    pillar = [
        Slice(cell.height_nm / count, cell.n_pillar, cell.n_ambient, *cell.sizes_nm((i + 0.5) / count))
        for i in range(count)
    ]
    under = [_sized(layer, cell.sizes_nm(0.0)) for layer in cell.under]
    over = [_sized(layer, cell.sizes_nm(1.0)) for layer in cell.over]
    return (*under, *pillar, *over)


def _sized(layer: Slice, size_nm: tuple[float, float]) -> Slice:
    width_nm = size_nm[0] if layer.width_nm is None else layer.width_nm
    length_nm = size_nm[1] if layer.length_nm is None else layer.length_nm
    return replace(layer, width_nm=width_nm, length_nm=length_nm)


def polarisations_swap(cell: PillarCell) -> bool:
    """Whether exchanging x and y exchanges the two polarisations and changes nothing else."""
    same_sizes = cell.shape == "cross" or all(each.width_nm == each.length_nm for each in layers_of(cell))
    same_sizes = same_sizes and cell.period_nm[0] == cell.period_nm[1] and not cell.is_staggered
    return same_sizes and cell.angle_deg == 0.0 and cell.n_substrate[0] == cell.n_substrate[1]


def in_plane_per_nm(cell: PillarCell) -> tuple[float, float]:
    """Wave vector (k_x, k_y) of the incident light in the plane of the cell, rad/nm."""
    k_x, k_y = cell.in_plane
    return cell.k0_per_nm * k_x, cell.k0_per_nm * k_y


def symmetry_classes(
    cell: PillarCell, orders: int, formulation: Formulation, steps: int = 1
) -> Iterator[SymmetryClass]:
    """Yield the symmetry classes that incident light of either polarisation excites.

    Args:
        orders: cosines besides the constant along each axis, equally many along a short and a long period: with fewer
            along the short one, the error does not fall as orders are added.
        formulation: "adaptive" or "fourier".
        steps: steps of a sloped pillar.

    Raises:
        InputError: light at an angle meets a birefringent substrate of unknown index along z, or comes out of a biaxial
            or an absorbing one; or the pillar is a ring.
    """
    if cell.shape == "ring":
        remedy = "upright rings of dielectrics are solved under light along z, others by meep"
        raise InputError.single("cell", "shape", "another shape for RCWA", "'ring'", remedy)
    layers = layers_of(cell, steps)
    if cell.is_staggered:
        x, y, counts = _staggered_axes(cell, orders, formulation)
    else:
        x, y, counts = _layered_axes(cell, layers, orders, formulation)
    if cell.angle_deg == 0.0:
        for i, even_first in enumerate((True, False)):
            u, v = ([symmetric_axis(each, even_first=even_first) for each in axis] for axis in (x, y))
            yield SymmetryClass(cell, _over_outlines(u, v, counts), layers, cell.n_in[i], cell.n_out[i])
        return
    _check_oblique(cell)
    k_x, k_y = in_plane_per_nm(cell)
    # If only one axis has parity, each of its two classes holds one polarisation.
    for u_class in zip(*(parities(each, k_x) for each in x), strict=True):
        for v_class in zip(*(parities(each, k_y) for each in y), strict=True):
            bases = _over_outlines(u_class, v_class, counts)
            yield SymmetryClass(cell, bases, layers, cell.n_in[0], cell.n_out[0])


_Axes = tuple[tuple[AxisBasis, ...], tuple[AxisBasis, ...], tuple[int, ...]]


def _layered_axes(cell: PillarCell, layers: tuple[Slice, ...], orders: int, formulation: Formulation) -> _Axes:
    """Bases along x and y of every rectangle of every layer, and the number of rectangles of each layer."""
    outlines = [_outline(cell, each, orders) for each in layers]
    sizes = [size for outline in outlines for size in outline]
    # A sloped pillar's ends are always included, so that more steps do not change the coordinates.
    ends = [cell.sizes_nm(0.0), cell.sizes_nm(1.0)] if cell.is_sloped else []
    widths, lengths = zip(*sizes, *ends, strict=True)
    x = outline_bases(cell.period_nm[0], widths, orders, formulation)
    y = outline_bases(cell.period_nm[1], lengths, orders, formulation)
    return x[: len(sizes)], y[: len(sizes)], tuple(map(len, outlines))


def _outline(cell: PillarCell, layer: Slice, orders: int) -> Rectangles:
    """Rectangles of one layer; a closed film counts as one."""
    width_nm, length_nm = layer.width_nm or 0.0, layer.length_nm or 0.0
    if layer.n_inside == layer.n_around:
        return ((width_nm, length_nm),)
    return rectangles(cell, width_nm, length_nm, orders)


def _staggered_axes(cell: PillarCell, orders: int, formulation: Formulation) -> _Axes:
    """Bases of the outlines of the pillar and of the gap around it, in the centred cell of a hexagonal lattice."""
    faults = cell.untreated("a hexagonal lattice by RCWA", treated=("is_staggered",))
    if faults:
        raise InputError("cell", faults)
    period, rows = cell.period_nm[0], 2.0 * cell.period_nm[1]
    x = outline_bases(period, (cell.width_nm, period - cell.width_nm), orders, formulation)
    y = outline_bases(rows, (cell.length_nm, rows - cell.length_nm), 2 * orders, formulation)
    return x, y, (2,)


def _over_outlines(
    u: Sequence[AxisParity], v: Sequence[AxisParity], counts: tuple[int, ...]
) -> tuple[tuple[TransverseBasis, ...], ...]:
    """A basis for each outline along both axes, ``counts`` of them in each layer."""
    first = transverse_basis(u[0], v[0])
    bases = (first, *(replace(first, u=of_x, v=of_y) for of_x, of_y in zip(u[1:], v[1:], strict=True)))
    each = iter(bases)
    return tuple(tuple(islice(each, count)) for count in counts)


def _check_oblique(cell: PillarCell) -> None:
    n_x, n_y = cell.n_substrate
    if n_x != n_y and cell.n_substrate_z is None:
        expected = "0 for a birefringent substrate without an index along z"
        remedy = "give the substrate's `n_z` too (sapphire with its axis in the surface: the ordinary index)"
    elif cell.side == "substrate" and n_x != n_y and cell.n_substrate_z not in (n_x, n_y):
        expected = "0 for light out of a biaxial substrate, which has no ordinary wave"
        remedy = 'set `side = "ambient"`'
    elif complex(cell.n_of_angle).imag != 0.0:
        expected = "0 for light out of an absorbing medium"
        remedy = "set k of that medium to 0: in it, no oblique plane wave has constant amplitude along the surface"
    else:
        return
    raise InputError.single("cell", "angle_deg", expected, f"{cell.angle_deg:g}", remedy)
