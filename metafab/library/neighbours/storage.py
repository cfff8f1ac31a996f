"""Chains of coupled modes in the HDF5 file of a library, group ``/neighbours``."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import h5py
import numpy as np

from metafab.core.figures import LineStatistics
from metafab.core.storage import hdf5
from metafab.library.neighbours.blocks.cross import free_elements
from metafab.library.neighbours.line import PARAMETERS, LineModel, LineShape
from metafab.library.neighbours.model import Neighbours, TrainedLine

_TEXT = {
    "site": "free elements of the site matrix, by term of T_i(along) T_j(across), i + j up to the degree",
    "own": "transmitted field of the even modes at their own site, by term",
    "side": "transmitted field of the modes at the neighbouring site, by term",
    "back_own": "reflected field of the even modes at their own site, by term",
    "back_side": "reflected field of the modes at the neighbouring site, by term",
    "hop": "free elements of the hop to the next site",
}
_STATISTIC, _COUPLING, _CROSS = "detail_", "coupling", "cross"


def put_neighbours(group: h5py.Group, neighbours: Neighbours) -> None:
    """Write the chains to an empty group."""
    group.attrs["inputs_sha256"] = neighbours.inputs_sha256
    directions = ("x",) if neighbours.shares_directions else ("x", "y")
    for number, direction in enumerate(directions):
        _put_line(group.create_group(f"rows_{direction}_along"), neighbours.along[number])
        _put_line(group.create_group(f"rows_{direction}_across"), neighbours.across[number])
    if neighbours.cross is not None:
        text = "free elements of the couplings of both polarisations"
        hdf5.put(group, _CROSS, neighbours.cross, units="1", description=text)


def neighbours_of(group: h5py.Group) -> Neighbours:
    """Read the chains.

    Raises:
        KeyError: an array is missing, or its shape does not fit the numbers of modes and terms.
    """
    directions = ("x", "y" if "rows_y_along" in group else "x")
    lines = {
        name: _line(group[name]) for name in {f"rows_{d}_{light}" for d in directions for light in ("along", "across")}
    }
    x, y = directions
    neighbours = Neighbours(
        along=(lines[f"rows_{x}_along"], lines[f"rows_{y}_along"]),
        across=(lines[f"rows_{x}_across"], lines[f"rows_{y}_across"]),
        inputs_sha256=str(group.attrs["inputs_sha256"]),
    )
    if _CROSS not in group:
        return neighbours
    cross, expected = np.asarray(group[_CROSS][()], dtype=np.complex128), (free_elements(neighbours),)
    if cross.shape != expected:
        raise KeyError(f"{_CROSS} of shape {expected} in {group.name}")
    return replace(neighbours, cross=cross)


def _put_line(group: h5py.Group, line: TrainedLine) -> None:
    model = line.model
    for field in fields(LineShape):
        group.attrs[field.name] = getattr(model.shape, field.name)
    for name, value in vars(line.statistics).items():
        if not math.isnan(value):
            group.attrs[_STATISTIC + name] = value
    for side, span_nm in (("along", model.along_nm), ("across", model.across_nm)):
        hdf5.put(group, f"{side}_nm", span_nm, units="nm", description=f"range of sizes {side} the row")
    for name in PARAMETERS:
        hdf5.put(group, name, getattr(model, name), units="1", description=_TEXT[name])
    if line.coupling is not None:
        hdf5.put(group, _COUPLING, line.coupling, units="1", description="free elements of the coupling across lines")


def _line(group: h5py.Group) -> TrainedLine:
    shape = LineShape(**{field.name: int(group.attrs[field.name]) for field in fields(LineShape)})
    n_pairs, n_hops = shape.pairs[0].size, shape.hop_pairs[0].size
    own, side = (shape.terms, shape.even), (shape.terms, shape.modes)
    expected = dict(zip(PARAMETERS, ((shape.terms, n_pairs), own, side, own, side, (n_hops,)), strict=True))
    # Older files hold the source itself, which is the reflected field of modes that radiate at their own site only.
    stored = {"back_own": "source"} if "source" in group else {}
    read = [name for name in PARAMETERS if not (stored and name == "back_side")]
    arrays = {name: np.asarray(group[stored.get(name, name)][()], dtype=np.complex128) for name in read}
    arrays.setdefault("back_side", np.zeros(expected["back_side"], dtype=np.complex128))
    for name, array in arrays.items():
        if array.shape != expected[name]:
            raise KeyError(f"{name} of shape {expected[name]} in {group.name}")
    along, across = (tuple(float(value) for value in group[f"{side}_nm"][()]) for side in ("along", "across"))
    known = {name: value for name, value in vars(LineStatistics()).items() if _STATISTIC + name in group.attrs}
    statistics = LineStatistics(
        **{name: type(default)(group.attrs[_STATISTIC + name]) for name, default in known.items()}
    )
    coupling = np.asarray(group[_COUPLING][()], dtype=np.complex128) if _COUPLING in group else None
    if coupling is not None and coupling.shape != (n_pairs,):
        raise KeyError(f"{_COUPLING} of shape {(n_pairs,)} in {group.name}")
    return TrainedLine(LineModel(shape, (along[0], along[1]), (across[0], across[1]), **arrays), statistics, coupling)
