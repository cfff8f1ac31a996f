"""No frame raises: what cannot be decoded comes back empty, with a reason or without a claim."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from metafab.camera import RawFrame, capture
from metafab.core.errors import InputError
from metafab.decode import Image4D, decode
from metafab.optics.point_spread import Psf
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import PIXEL_UM, helix_psf


@pytest.fixture(scope="module")
def psf() -> Psf:
    return helix_psf(np.linspace(0.0025, 0.0034, 7))


@pytest.fixture(scope="module")
def good(psf: Psf) -> RawFrame:
    return capture(Scene(objects=(SceneObject(depth_m=0.0029, size=(0.08, 0.08)),), field_px=(64, 64)), psf)


def claims(image: Image4D) -> int:
    return int(np.isfinite(image.depth_m).sum())


@pytest.mark.parametrize(
    "values",
    [
        np.zeros((176, 350)),
        np.full((176, 350), np.nan),
        np.full((176, 350), np.inf),
        np.full((176, 350), 65535.0),
        np.full((176, 350), -5.0),
        np.zeros((1, 1)),
        np.zeros((0, 0)),
        np.zeros((3, 4000)),
        np.zeros((5, 5, 3)),
        np.array([["a"]]),
        np.ones((64, 64), dtype=complex),
    ],
    ids=["black", "nan", "inf", "saturated", "negative", "pixel", "none", "strip", "colour", "text", "complex"],
)
def test_hopeless_frames_claim_nothing(psf: Psf, values: np.ndarray) -> None:
    frame = RawFrame(values, PIXEL_UM, (-420.0, -211.2), 2.0, saturation_e=65535.0)
    image = decode(frame, psf)
    assert claims(image) == 0
    assert image.figures.reason
    assert image.figures.reason in repr(image)


def test_an_array_is_no_frame(psf: Psf, good: RawFrame) -> None:
    with pytest.raises(InputError, match=r"`frame`: expected a RawFrame, .*got ndarray"):
        decode(good.frame, psf)  # type: ignore[arg-type]


def test_pure_noise_claims_nothing(psf: Psf) -> None:
    rng = np.random.default_rng(8)
    frame = RawFrame(rng.poisson(1000.0, (176, 350)).astype(float), PIXEL_UM, (-420.0, -211.2), 0.0)
    image = decode(frame, psf)
    # The window's pixels are far from independent; one in a hundred may pass five standard deviations.
    assert claims(image) <= 0.01 * image.depth_m.size


def test_wrong_pixels_are_said(psf: Psf, good: RawFrame) -> None:
    image = decode(dataclasses.replace(good, pixel_um=3.45), psf)
    assert claims(image) == 0
    assert "calibration" in str(image.figures.reason)


@pytest.mark.parametrize(
    "wrong",
    [
        {"pixel_um": np.nan},
        {"pixel_um": 0.0},
        {"origin_um": (np.nan, 0.0)},
        {"origin_um": (1e300, -1e300), "x_window": None},
        {"read_noise_e": np.inf},
        {"x_window": (0, 0, 10**6, 10)},
        {"x_window": (-5, 0, 20, 20)},
    ],
    ids=str,
)
def test_frames_that_say_impossible_things_claim_nothing(psf: Psf, good: RawFrame, wrong: dict[str, object]) -> None:
    image = decode(dataclasses.replace(good, **wrong), psf)  # type: ignore[arg-type]
    assert claims(image) == 0
    assert image.figures.reason


def test_one_depth_is_no_calibration(psf: Psf, good: RawFrame) -> None:
    one = dataclasses.replace(psf, depth_m=psf.depth_m[:1], psf=psf.psf[:, :1], centre_um=psf.centre_um[:, :1])
    image = decode(good, one)
    assert "fewer than three" in str(image.figures.reason)


def test_dead_pixels_cost_little(psf: Psf, good: RawFrame) -> None:
    values = good.frame.copy()
    rng = np.random.default_rng(9)
    values[rng.integers(0, values.shape[0], 40), rng.integers(0, values.shape[1], 40)] = np.nan
    image = decode(dataclasses.replace(good, frame=values), psf)
    whole = decode(good, psf)
    assert image.nmae is not None
    assert whole.nmae is not None
    # A small object (49 pixels a side): its own noise is near 0.6 %.
    assert image.nmae < whole.nmae + 0.01


@pytest.mark.parametrize("share", [0.02, 0.2])
def test_saturated_pixels_are_left_out_and_the_rest_is_decoded(psf: Psf, good: RawFrame, share: float) -> None:
    level = float(np.quantile(good.frame, 1.0 - share))
    image = decode(dataclasses.replace(good, frame=np.minimum(good.frame, level), saturation_e=level), psf)
    assert image.figures.pixels_broken > 0.0
    known = np.isfinite(image.depth_m)
    assert not known.any() or np.abs(image.depth_m[known] / 0.0029 - 1.0).max() < 0.05


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    rows=st.integers(1, 200),
    columns=st.integers(1, 400),
    origin=st.tuples(st.floats(-1000, 1000), st.floats(-1000, 1000)),
    scale=st.sampled_from([0.0, 1.0, 1e4, 1e12, -1e4]),
    seed=st.integers(0, 1000),
)
@example(rows=81, columns=254, origin=(-97.0, 0.0), scale=1e12, seed=0)
def test_any_frame_comes_back(
    psf: Psf, rows: int, columns: int, origin: tuple[float, float], scale: float, seed: int
) -> None:
    values = np.random.default_rng(seed).normal(size=(rows, columns)) * scale
    image = decode(RawFrame(values, PIXEL_UM, origin, 1.0), psf)
    assert image.depth_m.shape == image.segment.shape == image.confidence.shape
    assert ((image.confidence > 0.0) <= np.isfinite(image.depth_m)).all()
