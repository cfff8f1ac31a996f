"""Supercells of upright pillars by spectral elements and plane waves: a Supercell in, its transmitted orders out.

- ``shapes``    polynomials on the side of an element, and their quadrature
- ``line``      numbering of the functions along one axis, periodic or mirrored
- ``mesh``      pillars and gaps as quadrilaterals, and the singular function of a corner
- ``mirror``    sums of the functions of a row that is its own mirror image
- ``basis``     the functions, and their values on each element
- ``assembly``  matrices of the layer, and overlaps with the plane waves of the half spaces
- ``solve``     the layer by doubling, the orders, and the bound on their error
- ``adjoint``   derivatives of orders by all sizes
"""

from metafab.cell.elements.adjoint import OrderGradients, order_gradients
from metafab.cell.elements.solve import ElementNumerics, orders_at, scattered_by_row, solve_supercell, supercell_orders

__all__ = [
    "ElementNumerics",
    "OrderGradients",
    "order_gradients",
    "orders_at",
    "scattered_by_row",
    "solve_supercell",
    "supercell_orders",
]
