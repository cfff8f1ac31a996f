"""Models over sizes and axes: functions of their own kind are found, and shapes fit the number of samples."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.library.fit.models import corner_shapes, fit_corner_models
from metafab.library.fit.rational import Samples


def rational(width_nm: np.ndarray, length_nm: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Four amplitudes with a pole that moves with both axes: t_yy(W, L) = t_xx(L, W)."""

    def channel(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        a, b = axes.T
        pole = u + 0.3 * v + 0.2 * a - 0.1 * b * u + 0.05j
        return np.asarray((1.0 + 0.5 * v + 0.3j * a * u) / pole)

    u, v = (width_nm - 175.0) / 75.0, (length_nm - 175.0) / 75.0
    x, y = channel(u, v), channel(v, u)
    return np.stack([x, y, 0.1 * x, 0.1 * y], axis=1)


def unknown_slopes(count: int) -> np.ndarray:
    return np.full((count, 2, 4), np.nan, dtype=np.complex128)


def rational_slopes(width_nm: np.ndarray, length_nm: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Derivatives of :func:`rational` by width and length."""

    def channel(u: np.ndarray, v: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a, b = axes.T
        pole = u + 0.3 * v + 0.2 * a - 0.1 * b * u + 0.05j
        return (0.3j * a - x * (1.0 - 0.1 * b)) / pole / 75.0, (0.5 - 0.3 * x) / pole / 75.0

    u, v = (width_nm - 175.0) / 75.0, (length_nm - 175.0) / 75.0
    x, y, _, _ = rational(width_nm, length_nm, axes).T
    of_x, of_y = channel(u, v, x), channel(v, u, y)[::-1]
    return np.stack([np.stack([dx, dy, 0.1 * dx, 0.1 * dy], axis=1) for dx, dy in zip(of_x, of_y, strict=True)], axis=1)


@pytest.mark.parametrize("exchange", [True, False])
def test_rational_functions_are_found_and_contracted_exactly(exchange: bool) -> None:
    """An amplitude of the model's own kind comes back to rounding, scattered and at one corner alike."""
    rng = np.random.default_rng(4)
    width_nm, length_nm = rng.uniform(100.0, 250.0, (2, 160))
    axes = rng.uniform(-1.0, 1.0, (160, 2))
    samples = Samples(width_nm, length_nm, rational(width_nm, length_nm, axes), axes, unknown_slopes(160))
    span = (100.0, 250.0)
    best = fit_corner_models(samples, np.arange(160) % 4 == 0, (span, span), exchange).best
    new = rng.uniform(100.0, 250.0, (2, 50))
    place = np.tile([0.3, -0.7], (50, 1))
    true = rational(*new, place)
    # Poles come as near as 0.05 to real sizes: amplitudes reach 30, and rounding with them.
    assert np.abs(best(*new, place) - true).max() < 1e-8
    assert np.allclose(best.at(place[0])(*new), best(*new, place), atol=1e-9)
    # A bias of 4 nm: the size drawn as 150 is made as 154.
    drawn = new - 4.0
    assert np.allclose(best.at(place[0], bias_nm=4.0)(*drawn), best(*new, place), atol=1e-9)


@pytest.mark.parametrize("exchange", [True, False])
def test_slopes_stand_for_samples(exchange: bool) -> None:
    """With slopes at most of 60 sizes the model is exact; by their values alone it is off by 1e-3 and more."""
    rng, span = np.random.default_rng(4), (100.0, 250.0)
    (width_nm, length_nm), axes = rng.uniform(*span, (2, 60)), rng.uniform(-1.0, 1.0, (60, 2))
    new, place = rng.uniform(*span, (2, 50)), np.tile([0.3, -0.7], (50, 1))
    errors = []
    for slopes in (rational_slopes(width_nm, length_nm, axes), unknown_slopes(60)):
        slopes[::9, 1] = np.nan
        samples = Samples(width_nm, length_nm, rational(width_nm, length_nm, axes), axes, slopes)
        best = fit_corner_models(samples, np.arange(60) % 4 == 0, (span, span), exchange).best
        errors.append(np.abs(best(*new, place) - rational(*new, place)).max())
    assert errors[0] < 1e-8
    assert errors[1] > 1e-3


@pytest.mark.parametrize("equations", [200, 600, 4000])
@pytest.mark.parametrize("variables", [0, 1, 2])
def test_more_samples_never_mean_poorer_shapes(equations: int, variables: int) -> None:
    """However many samples there are, shapes with poles are tried, and none has more unknowns than they determine."""
    shapes = corner_shapes(equations, variables)
    assert len(shapes) > 1
    assert all(shape.degrees[1] >= 7 for shape in shapes)
    assert all(shape.unknowns <= 0.7 * 2 * equations for shape in shapes)
    fewer = corner_shapes(equations // 2, variables)
    assert max(shape.degrees[0] for shape in shapes) >= max(shape.degrees[0] for shape in fewer)


def test_the_mirror_image_of_a_circle_adds_no_equation() -> None:
    """Of circles that x and y may be exchanged in, both polarisations are one: shapes are those of half the values."""
    rng = np.random.default_rng(4)
    diameter_nm, axes = rng.uniform(100.0, 250.0, 80), rng.uniform(-1.0, 1.0, (80, 1))
    x = rational(diameter_nm, diameter_nm, np.repeat(axes, 2, axis=1))
    held_out, span = np.arange(80) % 4 == 0, (100.0, 250.0)
    samples = Samples(diameter_nm, diameter_nm, x, axes, unknown_slopes(80))
    models = fit_corner_models(samples, held_out, (span, span), exchange=True)
    for model in (models.best, *models.rivals):
        assert model.shape.sizes == 1
        assert model.shape.unknowns <= 0.7 * 2 * 60
