"""The pair: what is drawn is what the results hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metafab.optics.measures.mtf import modulation_transfer
from metafab.report.figures import psf as figures
from metafab.report.style import panel
from tests.closed_form_run import turning_psf


def test_orientation_is_unwrapped() -> None:
    """The pair turns from 40 to 200 degrees; phi_deg jumps by 360 on the way, the curve must not."""
    _, axes = panel()
    figures.orientation(turning_psf(), axes)
    (line,) = axes.lines
    np.testing.assert_allclose(line.get_ydata(), 40.0 + 20.0 * np.arange(9))
    np.testing.assert_allclose(line.get_xdata(), 100.0 * np.linspace(0.25, 0.35, 9))
    assert axes.get_xlabel() == "object depth / cm"


def test_the_highest_peak_stands_below_the_frame() -> None:
    psf = turning_psf()
    _, axes = panel()
    figures.peak(psf, axes, ideal=replace(psf, psf=1.5 * psf.psf), source="target phases")
    assert axes.get_ylim()[1] > 1.05 * 1.5 * psf.psf.max()
    legend = axes.get_legend()
    assert legend is not None
    assert legend.get_texts()[0].get_text() == "x, target phases"


def test_psf_window_keeps_all_that_is_bright() -> None:
    """The lobe sits 8 pixels out with a deviation of 2: 4 % of its peak lies sqrt(2 ln 25) 2 = 5.07 pixels from it."""
    psf = turning_psf()
    half = figures.lit_half_px(psf)
    assert 8 + 5 <= half <= 8 + 5 + 3


def test_field_of_view_is_drawn_in_its_order() -> None:
    """Mark one direction by brightness: it must light up in its own column and row, lowest y at the bottom."""
    psf = turning_psf()
    assert psf.field is not None
    marked = psf.field.psf.copy()
    marked[1, 4, 0, 2] *= 5.0
    _, axes = panel()
    figures.over_field(replace(psf, field=replace(psf.field, psf=marked)), axes, "y")
    mosaic = np.asarray(axes.images[0].get_array())
    row, column = np.unravel_index(int(mosaic.argmax()), mosaic.shape)
    assert row < mosaic.shape[0] / 2
    assert column > mosaic.shape[1] * 2 / 3
    assert [label.get_text() for label in axes.get_xticklabels()] == ["−5.7", "0", "5.7"]


def test_modulation_of_a_gaussian_lobe() -> None:
    """exp(-r^2 / 8 um^2) has the transfer exp(-2 (pi f)^2 4 um^2), wherever it sits."""
    psf = turning_psf()
    frequency_per_um, curves = modulation_transfer(psf)
    assert frequency_per_um.shape == (17,)
    expected = np.exp(-8.0 * (np.pi * frequency_per_um) ** 2)
    for transfer in curves[0]:
        # The mean over a ring of width s = 1 / 33 um differs from the value at its mean frequency by half the second
        # derivative, at most 16 pi^2 um^2, times the variance, about s^2 / 12: 0.006.
        np.testing.assert_allclose(transfer, expected, atol=0.006)
