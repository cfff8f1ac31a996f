"""GDSII whose datatypes are doses in thousandths of the base dose, as Raith's and NanoMaker's software reads it.

Raith's dialect has 1000 times the dose factor in the record DATATYPE of every element (toolbox Raith_GDSII of the
National Research Council of Canada, version 1.2); NanoMaker has the dose in tenths of a percent there.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from metafab.core.errors import InputError
from metafab.core.numeric.compiled import compiled
from metafab.core.storage.files import whole_file
from metafab.mask.gdsii import records

#: Datatype of the base dose, and the largest datatype of a signed word.
_BASE, _LARGEST = 1000, 2**15 - 1


def write_dose_datatypes(source: Path, target: Path, layer: int, doses: Mapping[int, float]) -> None:
    """Copy a GDSII file; the datatypes of one layer become their doses in thousandths, those of all others 1000.

    Args:
        source: the file.
        target: the copy.
        layer: layer whose datatypes have doses.
        doses: dose of each datatype relative to the base dose.

    Raises:
        InputError: a dose is above 32.767 or below 0.0005.
    """
    table = np.zeros(_LARGEST + 1, dtype=np.int64)
    for datatype, dose in doses.items():
        table[datatype] = round(_BASE * dose)
        if not 1 <= table[datatype] <= _LARGEST:
            expected = "doses from 0.0005 to 32.767 of the base dose, as thousandths in two bytes"
            raise InputError.single("mask", "dose datatypes", expected, f"{dose:g}")
    with whole_file(target) as part:
        shutil.copyfile(source, part)
        content = np.memmap(part, dtype=np.uint8, mode="r+")
        _replace(content, layer, table)
        content.flush()
        del content  # Closes the map.


@compiled
def _replace(content: NDArray[np.uint8], layer: int, table: NDArray[np.int64]) -> None:
    """Replace the datatypes in the bytes of a GDSII file, shape (n,), by ``table``, shape (32768,)."""
    at, here = 0, False
    while at + 6 <= content.size:
        length = content[at] * 256 + content[at + 1]
        if length < 4:
            return
        kind = content[at + 2] * 256 + content[at + 3]
        value = content[at + 4] * 256 + content[at + 5]
        if kind == records.LAYER:
            here = value == layer
        elif kind == records.DATATYPE:
            value = table[value] if here else _BASE
            content[at + 4], content[at + 5] = value // 256, value % 256
        at += length
