"""What unlike neighbours do to the field of each pillar: a supercell in, its transmitted orders out."""

from metafab.cell.supercell import Supercell, SupercellOrders
from metafab.core.errors import InputError
from metafab.library.library import Library

__all__ = ["solve_supercell"]


def solve_supercell(library: Library, supercell: Supercell) -> SupercellOrders:
    """Transmitted orders of a supercell by the library's model of neighbours.

    Raises:
        InputError: the library holds no model of neighbours.
    """
    got = f"a library of lone pillars for {supercell.shape[1]} x {supercell.shape[0]} sites"
    remedy = "build the library from a unit cell with a table `[neighbours]`, or use the solver rcwa, meep or lone"
    raise InputError.single(f"library {library.inputs_sha256[:12]}", "neighbours", "a model of neighbours", got, remedy)
