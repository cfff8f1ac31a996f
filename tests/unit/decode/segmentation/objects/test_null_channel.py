"""Evidence of rectangles and ellipses against the dense Gaussian process that it stands for."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import scipy.fft
from numpy.typing import NDArray

from metafab.decode.matching.levels import LOWEST_FREQUENCY
from metafab.decode.segmentation.objects.null_channel import WINDOW, NullChannel, ShapeEvidence

STEP, UNIT = 3, 500.0
#: Prior of the texture and of the mean intensities, over the surface's light.
TEXTURE, LEVEL = 0.2, 0.7
RECTANGLE, LIGHT = np.array([47.3, 50.12, 2.1, 1.6]), np.array([1.3, 0.6])


@dataclass(frozen=True)
class Channel(NullChannel):
    """A null channel whose responses are blurs that widen with vergence."""

    def response(self, vergence_per_m: float) -> NDArray[np.complex128]:
        return np.asarray(self.crossed ** (vergence_per_m / 300.0))


def channel_of(spectrum: NDArray[np.complex128], noise: float = 40.0) -> Channel:
    ky, kx = scipy.fft.fftfreq(WINDOW)[:, None], scipy.fft.rfftfreq(WINDOW)
    x = np.exp(-30.0 * (ky**2 + kx**2) - 2j * np.pi * (0.8 * ky + 0.3 * kx))
    y = np.exp(-20.0 * (ky**2 + 2.0 * kx**2) + 2j * np.pi * 0.7 * kx)
    precision = 1.0 / (WINDOW * noise * (1.0 + 10.0 * ky**2 + 0.0 * kx)) ** 2
    optics = cast("Any", SimpleNamespace(downsampling=SimpleNamespace(step=STEP)))
    return Channel(optics, np.zeros((0,), np.complex64), np.stack((x, y)), spectrum, precision, UNIT)


def mean_light() -> NDArray[np.complex128]:
    """Transform of the rectangle by sums over the points of its sides."""
    points = (np.arange(4000) + 0.5) / 4000.0
    along_y, along_x = (
        2.0 * half * np.exp(-2j * np.pi * k[:, None] * (middle - half + 2.0 * half * points)).mean(axis=1)
        for middle, half, k in zip(
            RECTANGLE[:2], RECTANGLE[2:], (scipy.fft.fftfreq(WINDOW), scipy.fft.rfftfreq(WINDOW)), strict=True
        )
    )
    return np.outer(along_y, along_x)


def mean_light_of_ellipse() -> NDArray[np.complex128]:
    """Transform of the ellipse in the rectangle by sums over its chords."""
    places = np.sin(0.5 * np.pi * ((np.arange(2000) + 0.5) / 1000.0 - 1.0))  # dense towards the ends
    (middle_y, middle_x), (half_y, half_x) = RECTANGLE[:2], RECTANGLE[2:]
    ky, kx = scipy.fft.fftfreq(WINDOW), scipy.fft.rfftfreq(WINDOW)
    chord = half_x * np.sqrt(1.0 - places**2)  # half its length; an element of y is chord * half_y / half_x * pi / 2000
    along_x = 2.0 * chord * np.sinc(2.0 * chord * kx[:, None]) * np.exp(-2j * np.pi * middle_x * kx[:, None])
    along_y = np.exp(-2j * np.pi * ky[:, None] * (middle_y + half_y * places))
    return np.asarray(along_y * (half_y / half_x * np.pi / 2000.0 * chord) @ along_x.T)


def square_cover() -> NDArray[np.float64]:
    """Share of each pixel that the rectangle covers."""
    places = np.arange(WINDOW)[:, None] + [-0.5, 0.5]
    rows, columns = (
        np.clip(np.minimum(places[:, 1], middle + half) - np.maximum(places[:, 0], middle - half), 0.0, None)
        for middle, half in zip(RECTANGLE[:2], RECTANGLE[2:], strict=True)
    )
    return np.outer(rows, columns)


def dense_evidence(
    channel: Channel, vergence_per_m: float, cover: NDArray[np.float64], light: NDArray[np.complex128]
) -> float:
    n, (x, y) = WINDOW, channel.response(vergence_per_m)
    ky, kx = scipy.fft.fftfreq(n, STEP)[:, None], scipy.fft.fftfreq(n, STEP)
    covariance = scipy.fft.ifft2(1.0 / (ky**2 + kx**2 + LOWEST_FREQUENCY**2)).real
    row, column = np.nonzero(cover)
    among = covariance[row[:, None] - row, column[:, None] - column] / covariance[0, 0] + 1e-6 * np.eye(row.size)
    modes = np.zeros((row.size, n, n))
    modes[:, row, column] = (np.linalg.cholesky(among) * (TEXTURE * UNIT * cover[row, column])[:, None]).T
    pixel = np.sinc(scipy.fft.fftfreq(n))[:, None] * np.sinc(scipy.fft.rfftfreq(n))
    textures = scipy.fft.rfft2(modes) * pixel * (LIGHT[0] * x + LIGHT[1] * y)
    means = LEVEL * UNIT * light * np.stack((x, y))
    twice = np.full(n // 2 + 1, 2.0)
    twice[[0, -1]] = 1.0
    white = np.sqrt(channel.precision * twice)
    columns_of = np.concatenate([textures, means]) * white
    design = np.concatenate([columns_of.real, columns_of.imag], axis=1).reshape(row.size + 2, -1)
    data = np.concatenate([(channel.spectrum * white).real, (channel.spectrum * white).imag]).ravel()
    system = np.eye(row.size + 2) + design @ design.T
    target = design @ data
    return float(0.5 * target @ np.linalg.solve(system, target) - 0.5 * np.linalg.slogdet(system)[1])


@pytest.mark.parametrize("vergence_per_m", [250.0, 400.0])
def test_the_evidence_is_that_of_a_gaussian_process(vergence_per_m: float) -> None:
    channel = channel_of(scipy.fft.rfft2(np.random.default_rng(7).normal(0.0, 60.0, (WINDOW, WINDOW))))
    evidence = ShapeEvidence(channel)
    first = evidence.at(vergence_per_m, RECTANGLE, LIGHT)
    # The sums over the sides' points are good to 1e-7.
    assert first == pytest.approx(dense_evidence(channel, vergence_per_m, square_cover(), mean_light()), rel=1e-5)
    # Other places, depths and contrasts asked in between change nothing.
    evidence.at(1.1 * vergence_per_m, RECTANGLE + 0.5, LIGHT[::-1])
    assert ShapeEvidence(channel).at(vergence_per_m, RECTANGLE, LIGHT) == first
    assert evidence.at(vergence_per_m, RECTANGLE, LIGHT) == first


def test_the_evidence_of_an_ellipse_is_that_of_a_gaussian_process() -> None:
    channel = channel_of(scipy.fft.rfft2(np.random.default_rng(7).normal(0.0, 60.0, (WINDOW, WINDOW))))
    evidence = ShapeEvidence(channel).of_ellipses
    cover, light = evidence.cover(RECTANGLE), mean_light_of_ellipse()
    # The cover is counted by 25 points a pixel.
    assert cover.sum() == pytest.approx(np.pi * RECTANGLE[2] * RECTANGLE[3], rel=0.02)
    assert light[0, 0] == pytest.approx(np.pi * RECTANGLE[2] * RECTANGLE[3], rel=1e-5)
    expected = dense_evidence(channel, 300.0, cover, light)
    assert evidence.at(300.0, RECTANGLE, LIGHT) == pytest.approx(expected, rel=1e-5)


def test_the_light_of_a_rectangle_is_found_and_leaves_nothing() -> None:
    levels, vergence_per_m = np.array([250.0, -150.0]), 300.0
    empty = channel_of(np.zeros((WINDOW, WINDOW // 2 + 1), complex), noise=0.1)
    spectrum = (empty.response(vergence_per_m) * levels[:, None, None]).sum(axis=0) * mean_light()
    evidence = ShapeEvidence(channel_of(spectrum, noise=0.1))
    light = evidence.light(vergence_per_m, RECTANGLE, LIGHT)
    assert light == pytest.approx(1.0 + levels / UNIT, abs=0.01)
    assert evidence.left(vergence_per_m, RECTANGLE, LIGHT).max() < 0.05
    assert evidence.left(vergence_per_m, RECTANGLE + np.array([3.0, 0.0, 0.0, 0.0]), LIGHT).max() > 10.0
    assert evidence.cover(RECTANGLE).sum() == pytest.approx(4.0 * RECTANGLE[2] * RECTANGLE[3])
