"""Stacks along depth: interpolation, joining, leaving out, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.core.errors import InputError
from metafab.optics import Psf, at_depths
from metafab.optics.interpolation import concatenate, without_depths
from tests.conjugate_pair import helix_psf

DEPTHS = 1.0 / np.linspace(1e3 / 2.5, 1e3 / 3.4, 8)


@pytest.fixture(scope="module")
def stack() -> Psf:
    return helix_psf(DEPTHS, window_px=24, tangents=(np.array([-0.05, 0.05]), np.array([0.0])))


def test_stored_depths_come_back_untouched(stack: Psf) -> None:
    chosen = DEPTHS[[5, 1, 1]]
    assert np.array_equal(at_depths(stack, chosen), stack.psf[:, [5, 1, 1]])


def test_a_cubic_in_vergence_is_interpolated_exactly(stack: Psf) -> None:
    vergence = (1.0 / DEPTHS - 300.0)[:, None, None] / 100.0
    cubic = Psf(**{**vars(stack), "psf": np.tile(1.0 + vergence - 2.0 * vergence**2 + vergence**3, (2, 1, 4, 4))})
    wanted = np.array([0.0026, 0.0031])
    v = (1.0 / wanted - 300.0) / 100.0
    assert at_depths(cubic, wanted)[0, :, 0, 0] == pytest.approx(1.0 + v - 2.0 * v**2 + v**3)


@pytest.mark.parametrize("depth_m", [0.002, 0.004, float("nan")])
def test_nothing_is_extrapolated(stack: Psf, depth_m: float) -> None:
    with pytest.raises(InputError, match="depths from"):
        at_depths(stack, [depth_m])


def test_a_short_stack_is_not_interpolated(stack: Psf) -> None:
    short = without_depths(stack, np.arange(8) > 2)
    with pytest.raises(InputError, match="4 depths or more"):
        at_depths(short, [0.5 * (DEPTHS[0] + DEPTHS[1])])


def test_leaving_out_and_joining_undo_each_other(stack: Psf) -> None:
    first, second = without_depths(stack, np.arange(8) >= 3), without_depths(stack, np.arange(8) < 3)
    whole = concatenate([first, second])
    for name in ("depth_m", "psf", "centre_um", "phi_deg", "error", "efficiency", "extinction_ratio"):
        assert np.array_equal(getattr(whole, name), getattr(stack, name))
    assert first.field is not None and first.field.psf.shape[1] == 3


def test_stacks_that_do_not_fit_are_not_joined(stack: Psf) -> None:
    with pytest.raises(ValueError, match="ascending"):
        concatenate([stack, stack])
    with pytest.raises(ValueError, match="sampling"):
        concatenate([stack, Psf(**{**vars(stack), "pixel_um": 1.0, "depth_m": DEPTHS + 1.0})])
