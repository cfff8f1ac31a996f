"""Library files as their unit cell asks for them: pillars among equal neighbours, then the model of unlike ones."""

from __future__ import annotations

from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import replace
from glob import escape
from pathlib import Path

import h5py

from metafab.cell import CellSolver, solve
from metafab.core.arguments import require_types
from metafab.core.parallel.progress import Progress, silent
from metafab.library import store
from metafab.library.library import Library
from metafab.library.neighbours.training import inputs_of_rows, inputs_of_training, train
from metafab.library.sweep.build import BuildNumerics, build_lone, with_target
from metafab.spec import UnitCell


def build_file(
    unit_cell: UnitCell,
    path: Path | str,
    *,
    target_error: float | None = None,
    executor: Executor | None = None,
    progress: Progress = silent,
    solver: CellSolver = solve,
    every_size: bool = False,
) -> Library:
    """Build a library, train its model of neighbours if the unit cell asks for one, and save both.

    Pillars of an earlier file that are still current are not solved again: a training uses them, or they are the whole
    library where the unit cell no longer asks for a model. A killed build or training continues where it stopped: until
    the library is saved, files in its folder keep what was solved and fitted. The rows and blocks of a training stay
    there (``.rows``, ``.blocks``): another fit, or more of them, continue from them. If two processes build one
    library, the second waits for the first and loads its file. A damaged checkpoint raises InputError.

    Args:
        unit_cell: unit cell with its sweep and, for a model of neighbours, the table ``[neighbours]``.
        path: library file; an earlier file is replaced once the new one is complete.
        target_error: largest error in any complex amplitude; default is ``unit_cell.sweep.target_error``.
        executor: runs the solvers; None for this process.
        solver: solves one unit cell; must be importable by the workers.
        every_size: solve every distinct size of the grid, none by a model.
    """
    require_types("library", unit_cell=(unit_cell, UnitCell))
    unit_cell, path = with_target(unit_cell, target_error), Path(path)
    asked = unit_cell.neighbours is not None
    kept = store.is_current(path, unit_cell) and (asked or not is_current(path, unit_cell))
    if kept:
        library = replace(store.load(path), unit_cell=unit_cell, neighbours=None)
    else:
        library = build_lone(unit_cell, path, executor, progress, solver, BuildNumerics(every_size))
    if not asked:
        if kept:
            store.save(library, path)
        return library
    checkpoint = path.with_name(f"{path.stem}.{inputs_of_rows(library)[:8]}.rows")
    trained = train(library, executor=executor, checkpoint=checkpoint, progress=progress)
    library = replace(library, neighbours=trained)
    store.save(library, path)
    # Of this training, and of stopped ones that fitted otherwise.
    for fits in path.parent.glob(f"{escape(checkpoint.stem)}.*.fits"):
        with suppress(OSError):  # another process has it open, on Windows
            fits.unlink()
    return library


def is_current(path: Path, unit_cell: UnitCell) -> bool:
    """Return whether ``path`` is a library that this version built from exactly this unit cell, with its neighbours."""
    if not store.is_current(path, unit_cell):
        return False
    with h5py.File(path, "r") as file:
        trained = str(file["neighbours"].attrs["inputs_sha256"]) if "neighbours" in file else ""
    return trained == ("" if unit_cell.neighbours is None else inputs_of_training(unit_cell))
