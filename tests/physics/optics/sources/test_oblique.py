"""Light that depends on its direction: PSFs over the field against pillars whose table is that of one direction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.core.errors import InputError
from metafab.library.use.oblique import ObliqueChange, powers
from metafab.optics import PsfNumerics, WrittenField, psf, relative_l2
from metafab.optics.sources.oblique import ObliqueField, from_direction
from metafab.optics.sources.source import apodised
from tests import optics_lens as lens

OPTICS = lens.imaging()
NUMERICS = PsfNumerics(window_px=16, target_error=1e-3)
NODE, DEPTHS_M = (0.08, -0.06), (1.0e-3,)


@pytest.fixture(scope="module")
def oblique() -> ObliqueField:
    """A lens whose amplitudes change by some 10 % at the node."""
    straight = lens.written(OPTICS, lens.eq_2(OPTICS), lens.eq_3_and_4(OPTICS))
    rng = np.random.default_rng(4)
    shape = (len(straight.table), 4, 2)
    coefficients = 4.0 * (1.0 + rng.normal(size=shape) + 1j * rng.normal(size=shape)) * straight.table[:, None]
    return ObliqueField(straight, ObliqueChange(coefficients, reach=0.08, change=0.1, left=0.0))


def _at_node(oblique: ObliqueField) -> WrittenField:
    change = np.einsum("k,nkp->np", powers(NODE), oblique.change.coefficients)
    return replace(oblique.straight, table=oblique.straight.table + change)


def test_psfs_over_the_field_are_those_of_each_direction(oblique: ObliqueField) -> None:
    grid = (np.array([-0.08, 0.0, 0.08]), np.array([-0.06, 0.0, 0.06]))
    lit = apodised(oblique, lambda x, y: np.ones((y.size, x.size)))
    stack = psf(lit, OPTICS, DEPTHS_M, NUMERICS, field_tangents=grid)
    alone = psf(_at_node(oblique), OPTICS, DEPTHS_M, NUMERICS, tangent=NODE)
    straight = psf(oblique.straight, OPTICS, DEPTHS_M, NUMERICS, tangent=NODE)
    assert stack.field is not None
    for polarisation in (0, 1):
        found, true = stack.field.psf[polarisation, 0, 0, 2], alone.psf[polarisation, 0]
        assert relative_l2(straight.psf[polarisation, 0], true) > 0.02
        assert relative_l2(found, true) <= stack.details.field_error + float(alone.error[0])
    # On the axis nothing has changed.
    assert relative_l2(stack.psf, psf(oblique.straight, OPTICS, DEPTHS_M, NUMERICS).psf) <= 2.0 * stack.error[0]


def test_one_direction_has_the_power_of_its_own_table(oblique: ObliqueField) -> None:
    stack, alone = (psf(source, OPTICS, DEPTHS_M, NUMERICS, tangent=NODE) for source in (oblique, _at_node(oblique)))
    assert np.array_equal(stack.psf, alone.psf)
    assert stack.details.transmitted == alone.details.transmitted


def test_light_without_a_change_stays_the_source_itself(oblique: ObliqueField) -> None:
    assert from_direction(oblique.straight, NODE, None) is oblique.straight


def test_directions_beyond_those_solved_are_refused(oblique: ObliqueField) -> None:
    with pytest.raises(InputError, match="corner of the scene's field"):
        psf(oblique, OPTICS, DEPTHS_M, NUMERICS, tangent=(0.2, 0.0))
