"""Shape correction: sizes to draw, at one dose, so that pillars print at the wanted sizes.

Each round predicts the printed sizes and subtracts their errors from the drawn sizes, which stay on a grid of two
database units. Sizes end within half a step of the grid.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor

import numpy as np

from metafab.core.conventions import Float32Array, FloatArray
from metafab.core.parallel.progress import Progress
from metafab.exposure.electrons.beam import BeamPsf
from metafab.exposure.energy.beside import Beside
from metafab.exposure.energy.resist import ResistEnergy
from metafab.exposure.prediction import NO_PLACES, Printing, predict
from metafab.exposure.printing import EdgeTables
from metafab.layout import PillarMap
from metafab.layout.outlines import Outline
from metafab.layout.pillars import bands, resized

#: Largest number of rounds, and the share of sizes that change in the last one.
_MOST_ROUNDS, _SETTLED = 8, 1e-3
#: Step of drawn sizes (database units): centred rectangles have their edges on the grid.
_STEP_DBU = 2
#: Growth of a pillar that does not print (nm).
_UNPRINTED_NM = 20.0


def printing_of(
    drawn: PillarMap,
    wanted: PillarMap,
    psf: BeamPsf,
    outline: Outline,
    beside: Beside | None,
    base_over_clearing_dose: float,
    executor: Executor,
) -> Printing:
    """Return the process of drawn pillars that should print as other sizes at the sites of the same lattice.

    The lenses of ``beside`` are drawn like this one.
    """
    resist = ResistEnergy(drawn, psf, outline).among(beside and beside.with_pillars(drawn))
    difference = np.zeros((2, *resist.size_index.shape), dtype=np.float32)
    wanted_nm, wanted_index = wanted.size_nm().astype(np.float32), wanted.to_array()
    drawn_nm = resist.size_nm.astype(np.float32)
    for rows in bands(resist.size_index):
        for axis in (0, 1):
            old = drawn_nm[resist.size_index[rows], axis]
            difference[axis, rows] = wanted_nm[wanted_index[rows], axis] - old
    return Printing(resist, EdgeTables.of(psf, resist.shapes), base_over_clearing_dose, executor, difference)


def corrected_shapes(
    wanted: PillarMap, printing: Callable[[PillarMap], Printing], progress: Progress
) -> tuple[PillarMap, int]:
    """Find the sizes to draw for the pillars that should be printed; return the pillars and the number of rounds.

    ``printing`` gives the process of drawn pillars (:func:`printing_of`).
    """
    dose = np.ones(wanted.lattice.shape, dtype=np.float32)
    drawn = wanted
    for number in range(1, _MOST_ROUNDS + 1):
        process = printing(drawn)
        found = predict(process, dose, NO_PLACES, keep_sizes=True).printed_less_drawn_nm
        assert process.wanted_less_drawn_nm is not None
        assert found is not None
        error_nm = np.subtract(found, process.wanted_less_drawn_nm, out=found)
        drawn, changed = _resized(drawn, error_nm)
        progress("correction", number, _MOST_ROUNDS)
        if changed < _SETTLED:
            break
    return drawn, number


def _resized(drawn: PillarMap, error_nm: Float32Array) -> tuple[PillarMap, float]:
    """Subtract size errors, shape (2, n_y, n_x), on the grid; and return the share of sizes that change."""
    lattice, index = drawn.lattice, drawn.to_array()
    drawn_nm = drawn.size_nm().astype(np.float32).T
    step_nm = np.float32(_STEP_DBU * lattice.database_unit_nm)
    largest = np.array(lattice.cell_dbu, dtype=np.float32)[:, None, None] * np.float32(lattice.database_unit_nm)
    growth = np.where(np.isfinite(error_nm), error_nm, -_UNPRINTED_NM)
    np.multiply(np.rint(growth / step_nm), -step_nm, out=growth)
    changed = int(np.count_nonzero(growth[:, index > 0]))

    def sizes_nm(rows: slice) -> FloatArray:
        new = np.clip(drawn_nm[:, index[rows]] + growth[:, rows], step_nm, largest - step_nm)
        return np.asarray(new, dtype=np.float64)

    return resized(drawn, sizes_nm, _STEP_DBU), changed / max(1, 2 * int(np.count_nonzero(index)))
