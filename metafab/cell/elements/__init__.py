"""Supercells of upright pillars by spectral elements and plane waves: a Supercell in, its transmitted orders out.

- ``line``      polynomials on the side of an element, and their numbers along one axis, periodic or mirrored;
                sums of the functions of a row that is its own mirror image
- ``mesh``      pillars and gaps as quadrilaterals, and the singular function of a corner
- ``basis``     the functions, and their values on each element
- ``assembly``  matrices of the layer, and overlaps with the plane waves of the half spaces
- ``solve``     the layer by doubling, the orders, and the bound on their error
- ``adjoint``   derivatives of orders by all sizes
"""

from typing import TYPE_CHECKING

from metafab.core.further import further_names

# Imported when first used: `solve` also treats curved outlines, whose elements are built from those of this folder.
if not TYPE_CHECKING:
    __getattr__ = further_names(
        __name__,
        {
            "metafab.cell.elements.adjoint": "OrderGradients order_gradients",
            "metafab.cell.elements.solve": (
                "ElementNumerics orders_at scattered_by_row solve_supercell supercell_orders"
            ),
        },
    )
