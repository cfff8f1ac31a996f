"""Windows cut into tiles, and put together again."""

from __future__ import annotations

import numpy as np
import scipy.fft
from hypothesis import given, settings
from hypothesis import strategies as st

from metafab.decode.registration.tiles import Tiling


@settings(max_examples=60, deadline=None)
@given(
    shape=st.tuples(st.integers(1, 60), st.integers(1, 60)),
    margin=st.integers(1, 12),
    core=st.tuples(st.floats(2.0, 80.0), st.floats(2.0, 80.0)),
)
def test_tiles_give_the_window_back(shape: tuple[int, int], margin: int, core: tuple[float, float]) -> None:
    tiling = Tiling.over(shape, margin, core)
    image = np.random.default_rng(3).normal(size=(shape[0] + 2 * margin, shape[1] + 2 * margin))
    back = np.full(shape, np.nan)
    for tile, core_px in enumerate(tiling.cores(scipy.fft.rfft2(list(tiling.cut(image, np.arange(tiling.n_tiles)))))):
        rows, columns = back[tiling.place(tile)].shape
        assert np.isnan(back[tiling.place(tile)]).all()
        back[tiling.place(tile)] = core_px[:rows, :columns]
    np.testing.assert_allclose(back, image[margin:-margin, margin:-margin], atol=1e-5)


def test_only_touched_tiles_are_cut() -> None:
    tiling = Tiling.over((40, 60), 4, (20.0, 20.0))
    mask = np.zeros((40, 60), dtype=bool)
    mask[25, 45] = True
    assert tiling.tiles_with(mask).tolist() == [5]
    assert mask[tiling.place(5)].sum() == 1
    assert tiling.labels_of_tiles(np.where(mask, 7, 0).astype(np.int32), 9) == [(5, 7)]
    assert tiling.labels_of_tiles(np.zeros((40, 60), dtype=np.int32), 9) == []
    label = np.random.default_rng(2).integers(0, 3, (40, 60), dtype=np.int32)
    want = [(tile, k) for tile in range(tiling.n_tiles) for k in np.unique(label[tiling.place(tile)]).tolist() if k > 0]
    assert tiling.labels_of_tiles(label, 4) == want


def test_lone_pixels_are_left_out() -> None:
    """Of three in one tile and one in the next, the three stay; the tiles' cores reach beyond the window."""
    tiling = Tiling.over((10, 14), 2, (6, 6))
    mask = np.zeros((10, 14), dtype=bool)
    mask[0, :3] = mask[9, 13] = True
    expected = mask.copy()
    expected[9, 13] = False
    assert (tiling.in_many(mask, 2) == expected).all()
    assert (tiling.in_many(mask, 1) == mask).all()
