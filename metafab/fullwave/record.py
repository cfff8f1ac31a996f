"""Record of solved blocks: a stopped or failed ``metafab fullwave`` leaves it, and the next one goes on with it."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from metafab.cell.supercell import Supercell, SupercellOrders
from metafab.core.storage.files import fingerprint
from metafab.library.sweep.checkpoint import Checkpoint, SolvedPoint


@contextmanager
def kept_blocks(
    beside: Path, inputs_sha256: str, say: Callable[[Sequence[str]], None] = lambda sentences: None
) -> Iterator[Checkpoint]:
    """Open the record of solved blocks, a file in the folder of ``beside``.

    The file stays only if the code of the ``with`` block fails, or is interrupted, after a block is solved; ``say`` is
    then called with its path. Beside a pipe, as a shell makes it, and in a folder that cannot be written, solved blocks
    are kept in memory only.

    Args:
        beside: the answer's file, or the file of the blocks.
        inputs_sha256: fingerprint of all that an answer depends on besides the pillars of its block.
    """
    place = beside.resolve()
    path = place.with_name(f"{place.stem}.{inputs_sha256[:8]}.partial")
    # A pipe has no folder: `/dev/stdin` resolves to a name that does not exist.
    is_kept = (beside.is_file() or not beside.exists()) and os.access(path.parent, os.W_OK)
    with Checkpoint(path if is_kept else None, inputs_sha256) as record:
        try:
            yield record
        except BaseException:
            if is_kept and record.points:
                say([f"solved blocks are kept in {path}; run it again to go on from there"])
            else:
                record.remove()
            raise
        record.remove()


def record_orders(record: Checkpoint, orders: SupercellOrders) -> None:
    """Add the answer for a block to a record."""
    t = tuple(orders.t.ravel().tolist())
    record.add([SolvedPoint(_number(orders.supercell), t, orders.error, orders.seconds)])


def recorded_orders(record: Checkpoint, supercells: Sequence[Supercell]) -> dict[int, SupercellOrders]:
    """Answers that a record holds, by the index of their supercell."""
    points, found = {point.number: point for point in record.points}, {}
    for index, supercell in enumerate(supercells):
        if (point := points.get(_number(supercell))) is not None:
            t, order = np.reshape(point.amplitudes, (-1, 2, 2)), supercell.propagating_orders("x")
            found[index] = SupercellOrders(supercell, order, t, point.error, point.seconds)
    return found


def _number(supercell: Supercell) -> int:
    """Number of a block in a record, from its pillars alone: blocks may change their places in the file."""
    return int(fingerprint(supercell.size_nm)[:15], 16)
