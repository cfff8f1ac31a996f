"""Interpolation over the field: exact at the nodes, refused outside, and nearer to the truth with more nodes."""

from __future__ import annotations

import numpy as np
import pytest

from metafab import layout, optics, phase
from metafab.core.errors import InputError
from metafab.optics import Imaging
from metafab.spec import Design


@pytest.fixture(scope="module")
def stacks(small_design: Design) -> tuple[list[optics.Psf], optics.Psf]:
    """The small lens' target phases (Eqs. 2 to 4) over 5 x 5 and 9 x 9 directions, and at one between the nodes."""
    from dataclasses import replace

    plain = replace(small_design, phase=(replace(small_design.phase[0], optimise="none"), small_design.phase[1]))
    source = optics.ideal_field(phase.profile_of(plain), layout.lattice_of(plain), plain.device)
    imaging = Imaging.of(plain)
    grids = [np.linspace(-0.1, 0.1, count) for count in (5, 9)]
    over_field = [
        optics.psf(source, imaging, (0.003,), optics.PsfNumerics(window_px=32), field_tangents=(g, g)) for g in grids
    ]
    return over_field, optics.psf(
        source, imaging, (0.003,), optics.PsfNumerics(window_px=32), tangent=(0.0625, -0.0625)
    )


def test_nodes_are_returned_as_they_are(stacks: tuple[list[optics.Psf], optics.Psf]) -> None:
    psf = stacks[0][0]
    assert psf.field is not None
    value = optics.at_tangent(psf, (0.05, -0.1))
    assert value == pytest.approx(np.asarray(psf.field.psf[:, :, 0, 3], dtype=np.float64), rel=1e-6, abs=1e-9)


def test_twice_the_nodes_come_nearer_to_the_computed_pair(stacks: tuple[list[optics.Psf], optics.Psf]) -> None:
    (coarse, fine), computed = stacks
    errors = [optics.relative_l2(optics.at_tangent(psf, (0.0625, -0.0625)), computed.psf) for psf in (coarse, fine)]
    # Cubic splines gain up to 2^4 with half the step; the outermost cells, where this direction lies, gain less.
    assert errors[1] < 0.35 * errors[0]
    assert errors[0] < 0.15


def test_nothing_is_extrapolated(stacks: tuple[list[optics.Psf], optics.Psf]) -> None:
    with pytest.raises(InputError, match="tangent_x"):
        optics.at_tangent(stacks[0][0], (0.11, 0.0))
    with pytest.raises(InputError, match="field"):
        optics.at_tangent(stacks[1], (0.0, 0.0))
