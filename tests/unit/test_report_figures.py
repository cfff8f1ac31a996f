"""Figures: what is drawn is what the results say, and nothing of matplotlib's global state is touched."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab.layout.outlines import Outline, Shape
from metafab.layout.pillars import Lattice, PillarMap
from metafab.library.library import Library
from metafab.report import benchmark_page, figures, html, library_figure
from metafab.report.accounts import chain_of, depths_against_truth, modulation_of
from metafab.report.mask_picture import picture_of
from metafab.report.run_folder import RunFolder
from metafab.report.style import depth_unit, panel
from tests.closed_form_run import decoded_image, pillar_map, raw_frame, turning_psf

PNG = b"\x89PNG"


def test_library_picture_is_written(smooth_library: Library, tmp_path: Path) -> None:
    path = library_figure(smooth_library, tmp_path / "library.png")
    assert path.read_bytes().startswith(PNG)


def test_phase_map_shows_the_angle_of_t(smooth_library: Library) -> None:
    _, axes = panel()
    figures.phase_map(smooth_library, axes, "y")
    (image,) = axes.images
    np.testing.assert_allclose(image.get_array(), np.angle(smooth_library.t_yy[0]))
    left, right, low, high = image.get_extent()
    # Pixels are centred on the sizes, 2 nm apart.
    assert (left, right, low, high) == (99.0, 251.0, 99.0, 251.0)


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


def test_mask_picture_counts_every_pillar_once() -> None:
    """Tiles of 40 sites do not divide 101: area over blocks must be the area of all pillars all the same."""
    pillars = pillar_map()
    picture = picture_of(pillars)
    period_nm = 350.0
    covered_nm2 = np.nansum(picture.fill) * (period_nm * picture.sites_a_pixel) ** 2
    index = pillars.to_array()
    expected_nm2 = np.prod(pillars.size_nm(), axis=1)[index].sum()
    assert covered_nm2 == pytest.approx(expected_nm2, rel=1e-12)
    assert picture.half_side_um == pytest.approx((0.175 * 101, 0.175 * 101))


@pytest.mark.parametrize("tile_sites", [7, 40, 101])
def test_mask_zoom_shows_the_pillars_of_the_map(tile_sites: int) -> None:
    whole = pillar_map()
    pillars = PillarMap.from_array(whole.lattice, whole.size_dbu, whole.to_array(), tile_sites)
    close = picture_of(pillars).zooms[1]
    assert close.shape == (100, 4)
    index, size_nm = whole.to_array(), whole.size_nm()
    x_um, y_um = whole.lattice.x_um(), whole.lattice.y_um()
    for x, y, width, length in close:
        row, column = int(np.argmin(abs(y_um - y))), int(np.argmin(abs(x_um - x)))
        assert (x_um[column], y_um[row]) == (x, y)
        np.testing.assert_allclose(1e3 * np.array([width, length]), size_nm[index[row, column]])


def test_big_lenses_are_binned() -> None:
    """More sites than pixels: blocks of sites share a pixel, and a full lattice is covered evenly."""
    whole = pillar_map()
    lattice = type(whole.lattice)(whole.lattice.period_dbu, (401, 801), whole.lattice.database_unit_nm)
    pillars = PillarMap.from_array(lattice, whole.size_dbu, np.ones(lattice.shape, dtype=np.uint16), 286)
    picture = picture_of(pillars)
    assert picture.sites_a_pixel == 3
    assert picture.fill.shape == (134, 267)
    share = 100.0 * 200.0 / 350.0**2
    np.testing.assert_allclose(picture.fill[:-1], share, rtol=1e-12)


def test_depth_against_truth_reads_the_truth_at_the_same_place_on_the_sensor() -> None:
    """Truth on a larger grid, shifted by whole pixels, must give the same pairs."""
    decoded, raw = decoded_image(), raw_frame()
    run = RunFolder(Path(), decoded=decoded, raw=raw)
    same = depths_against_truth(run)
    assert same is not None
    np.testing.assert_allclose(same[0], [0.26, 0.33])
    np.testing.assert_allclose(same[1], [0.2604, 0.3291])
    np.testing.assert_allclose(same[2], [4e-4, 8e-4])
    assert raw.truth is not None
    padded = np.pad(raw.truth.depth_m, ((3, 9), (5, 2)), constant_values=np.nan)
    shifted = (decoded.origin_um[0] - 5 * 3.45, decoded.origin_um[1] - 3 * 3.45)
    truth = type(raw.truth)(padded, raw.truth.intensity_x, raw.truth.intensity_y, raw.truth.label)
    moved = type(raw)(raw.frame, raw.pixel_um, raw.origin_um, raw.read_noise_e, truth, shifted)
    other = depths_against_truth(RunFolder(Path(), decoded=decoded, raw=moved))
    assert other is not None
    np.testing.assert_array_equal(np.array(other), np.array(same))


def test_modulation_of_a_gaussian_lobe() -> None:
    """exp(-r^2 / 8 um^2) has the transfer exp(-2 (pi f)^2 4 um^2), wherever it sits."""
    psf = turning_psf()
    frequency_per_mm, curves = modulation_of(psf)
    assert [name for name, _ in curves] == ["25 cm", "30 cm", "35 cm"]
    assert frequency_per_mm.shape == (17,)
    expected = np.exp(-8.0 * (np.pi * 1e-3 * frequency_per_mm) ** 2)
    for _, transfer in curves:
        # The mean over a ring of width s = 1 / 33 um differs from the value at its mean frequency by half the second
        # derivative, at most 16 pi^2 um^2, times the variance, about s^2 / 12: 0.006.
        np.testing.assert_allclose(transfer, expected, atol=0.006)


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


def test_loss_chain_falls_and_names_its_comparison() -> None:
    summary = {"psf": {"transmitted_x": 0.8, "transmitted_y": 0.7}}
    chain = chain_of(RunFolder(Path(), summary=summary, psf=turning_psf(0.6), ideal_psf=turning_psf(0.9)))
    assert [share for _, share in chain] == pytest.approx([1.0, 0.75, 0.6, 0.9])
    assert chain[-1][0].startswith("for comparison")


@pytest.mark.parametrize(("depth_m", "unit"), [(0.0034, "mm"), (0.34, "cm"), (200.0, "m")])
def test_depths_are_shown_in_a_unit_that_suits_them(depth_m: float, unit: str) -> None:
    scale, name = depth_unit(depth_m)
    assert name == unit
    assert 1.0 <= scale * depth_m < 1000.0


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"),
        (True, "yes"),
        (25600000, "25\u202f600\u202f000"),
        (4501.0, "4\u202f501"),
        (0.0017, "0.0017"),
        (-160.04, "−160"),
        (5.307e-6, "5.31\u202f×\u202f10<sup>−6</sup>"),
        (2.5e12, "2\u202f500\u202f000\u202f000\u202f000"),
        ("<b>", "&lt;b&gt;"),
    ],
)
def test_numbers_are_for_reading(value: object, text: str) -> None:
    assert html.number(value) == text


def test_benchmark_page_keeps_every_row(tmp_path: Path) -> None:
    rows = [
        {"room": "cell", "name": "ours", "error": 1e-3, "seconds": 0.01, "peak_rss_mb": 120.0},
        {"room": "cell", "name": "a peer & <friends>", "error": 1.3e-2, "seconds": 2.5, "peak_rss_mb": 300.0},
        {"room": "layout", "name": "no error known", "error": None, "seconds": 0.3, "peak_rss_mb": 90.0},
    ]
    page, data, *plots = benchmark_page(rows, tmp_path / "out")
    assert json.loads(data.read_text())["rows"] == rows
    assert [plot.name for plot in plots] == ["benchmark_cell.png", "benchmark_layout.png"]
    assert all(plot.read_bytes().startswith(PNG) for plot in plots)
    text = page.read_text(encoding="utf-8")
    assert "a peer &amp; &lt;friends&gt;" in text
    assert "http" not in text.replace("http://www.w3.org", "")


def test_global_state_stays_as_it_was(tmp_path: Path) -> None:
    """In a fresh process: drawing neither imports pyplot nor chooses a backend nor changes a setting."""
    code = (
        "import sys, matplotlib\n"
        "before = matplotlib.rcParams.copy()\n"
        "from pathlib import Path\n"
        "from metafab.report import benchmark_page\n"
        f"benchmark_page([{{'name': 'a', 'error': 0.1, 'seconds': 1.0}}], Path({str(tmp_path)!r}))\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
        "after = matplotlib.rcParams.copy()\n"
        "assert all(dict.__getitem__(after, key) == dict.__getitem__(before, key) for key in before)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("shape", ["rectangle", "ellipse", "cross"])
def test_mask_zoom_draws_the_outlines_of_the_file(shape: Shape) -> None:
    outline = Outline(shape, 0.5)
    pillars = np.array([[0.0, 0.0, 0.2, 0.1], [0.35, -0.35, 0.12, 0.12]])
    _, axes = panel((3.0, 3.0))
    figures.pillar_outlines(pillars, axes, "Single pillars", outline=outline, label_nearest=True)
    drawn, *_ = (patch.get_path() for patch in axes.patches)
    expected = [outline.vertices(400, 200) * 5e-4, outline.vertices(240, 240) * 5e-4 + [0.35, -0.35]]
    assert np.allclose(drawn.vertices, np.concatenate(expected), atol=1e-12)
    assert axes.get_title(loc="right") in {"200 × 100 nm", "120 × 120 nm"}


def test_mask_picture_of_a_hexagonal_lattice_shows_as_many_pillars_of_their_own_area() -> None:
    lattice = Lattice((380, 658), (61, 121), 0.5, hexagonal=True)
    index = lattice.carries(np.arange(61), np.arange(121)).astype(np.uint16)
    circle = Outline("ellipse", 0.5)
    pillars = PillarMap.from_array(lattice, np.array([[0, 0], [300, 300]], dtype=np.int32), index, 40)
    picture = picture_of(pillars, circle)
    assert len(picture.zooms[1]) == 100
    across, along = np.ptp(picture.zooms[1][:, :2], axis=0)
    assert across == pytest.approx(along, rel=0.25)
    # Each block of two columns and two rows holds two pillars: even grey, of the circle's own area.
    share = np.pi / 4.0 * 300.0**2 / (380.0 * 658.0) / 2.0
    assert picture.fill[:-1, :-1] == pytest.approx(share, rel=0.01)
