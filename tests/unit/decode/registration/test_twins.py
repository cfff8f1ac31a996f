"""Checks of a frame's pixels, and windows that reach beyond it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from metafab.decode.registration.twins import compilable, crop, validated


@pytest.mark.parametrize("corner", [(-2, -1), (1, 1), (3, -9), (40, 2)])
def test_a_window_beyond_the_frame_goes_on_with_its_edge(corner: tuple[int, int]) -> None:
    frame = np.arange(30.0, dtype=np.float32).reshape(5, 6)
    rows, columns = corner[0] + np.arange(3), corner[1] + np.arange(4)
    image = crop(frame, corner, (3, 4))
    assert (image == frame[np.ix_(rows.clip(0, 4), columns.clip(0, 5))]).all()


@settings(max_examples=40, deadline=None)
@given(
    kind=st.sampled_from(["f4", ">f4", "f8", "u1", "u2", ">u2", "i4", "?"]),
    saturation=st.sampled_from([200.0, np.inf]),
    seed=st.integers(0, 99),
)
def test_frames_of_any_type_are_checked_alike(kind: str, saturation: float, seed: int) -> None:
    """What is not a number, too bright or saturated is broken; the rest keeps its value."""
    rng = np.random.default_rng(seed)
    given_ = (rng.random((7, 9)) * 255).astype(kind)
    if given_.dtype.kind == "f":
        given_[0, :4] = np.nan, np.inf, -np.inf, 1e16
    values, broken = validated(compilable(given_), saturation)
    wide = given_.astype(np.float64)
    fine = np.isfinite(wide) & (np.abs(wide) < 1e15)
    np.testing.assert_array_equal(broken, ~fine | (fine & (wide >= saturation)))
    np.testing.assert_array_equal(values[fine], given_[fine].astype(np.float32))
    assert np.isnan(values[~fine]).all()
    assert values.dtype == np.float32
