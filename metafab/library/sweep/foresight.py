"""What a build will take, before it begins: cells by experience, their cost by the solver's own measure."""

from __future__ import annotations

from dataclasses import dataclass

from metafab.cell import pillar_cell, rcwa
from metafab.library.axes import CornerBox, corner_cell
from metafab.library.fit.sampling import SizeGrid
from metafab.library.sweep.corner_rounds import FIRST_ROUND, MOST_SAMPLES
from metafab.spec import UnitCell

#: Cells that libraries took: silicon at 940 and 800 nm about two hundred, titanium dioxide at 532 nm (many guided modes
#: of little loss) about a thousand.
FEW_CELLS, MANY_CELLS = 180, 1100


@dataclass(frozen=True)
class Foresight:
    """What a build is expected to take.

    Attributes:
        cells: fewest and most unit cells that it may solve.
        seconds: processor time of the least and the most, fits aside; divide by the workers.
    """

    cells: tuple[int, int]
    seconds: tuple[float, float]


def foresee(unit_cell: UnitCell, solver_error: float) -> Foresight | None:
    """Cells and processor time that a library of ``unit_cell`` is expected to take by RCWA.

    Resonant cells take up to five times as long as others, which is why the two ends are far apart.

    Args:
        unit_cell: what is swept.
        solver_error: what each cell is solved to.

    Returns:
        None for Meep, whose time hangs on the machine's cores and on resonances far more.
    """
    if unit_cell.solver.name != "rcwa":
        return None
    distinct = SizeGrid.of(unit_cell).distinct.size
    few, many = min(FEW_CELLS, distinct), min(MANY_CELLS, distinct)
    box = CornerBox.of(unit_cell)
    dimensions = 0 if box is None else 2 + len(box.variables)
    few_there, many_there = FIRST_ROUND * dimensions, MOST_SAMPLES * dimensions
    width_nm, length_nm = (0.5 * sum(span) for span in (unit_cell.sweep.width_nm, unit_cell.sweep.length_nm))
    each = rcwa.seconds_estimate(solver_error, pillar_cell(unit_cell, width_nm, length_nm))
    least, most = few * each, 5.0 * many * each
    if box is not None:
        corner = {name: high for name, (_, high) in box.spans.items()}
        there = rcwa.seconds_estimate(solver_error, corner_cell(unit_cell, width_nm, length_nm, corner))
        least, most = least + few_there * there, most + 5.0 * many_there * there
    return Foresight((few + few_there, many + many_there), (least, most))
