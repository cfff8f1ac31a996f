"""A patch that Meep simulated, in the report of its run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab import fullwave, optics, report
from metafab.core.figures import OrderFigures, OrdersFigures
from metafab.core.storage.files import file_sha256
from metafab.fullwave.coupling import CouplingRow
from metafab.optics.point_spread import NeighbourMap
from metafab.report.figures import mask as figures
from metafab.report.style import panel
from metafab.steps.summary import RunSummary
from tests.closed_form_run import turning_psf


@pytest.fixture
def patch() -> fullwave.Patch:
    """Six by four sites; Meep's field is the library's, turned by a tenth of a radian and a little brighter."""
    rng = np.random.default_rng(5)
    library = np.exp(2j * np.pi * rng.random((4, 6)))
    return fullwave.Patch(
        x_um=0.35 * np.arange(6) + 600.0,
        y_um=0.35 * np.arange(4) - 2.0,
        polarisation="y",
        full_wave=1.05 * np.exp(0.1j) * library,
        library=library,
        alone=1.05 * library,
        decay=1e-3,
        seconds=12.0,
        pixels_per_period=12,
        padding_sites=3,
    )


def test_the_page_shows_both_fields_and_their_differences(patch: fullwave.Patch, tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text("{}")
    without = report.write(tmp_path).read_text(encoding="utf-8")
    assert 'id="fullwave"' not in without
    assert "patch.h5" not in without, "what was not asked for is not missed"
    fullwave.save_patch(patch, tmp_path / "patch.h5", inputs_sha256="abc")
    text = report.write(tmp_path).read_text(encoding="utf-8")
    assert 'id="fullwave"' in text
    assert "6 x 4 pillars of the mask around (600.9, -1.5) um, y polarisation" in text
    drawn = {path.stem for path in (tmp_path / "figures").glob("patch_*.png")}
    assert drawn == {
        "patch_phase_meep", "patch_phase_library", "patch_amplitude_meep", "patch_amplitude_library",
        "patch_difference_library", "patch_difference_coupling",
    }  # fmt: skip
    # Amplitudes: 0.05 brighter than the library, as bright as the lone pillars.
    assert patch.against_library.amplitude_rms == pytest.approx(0.05)
    assert "0.05" in text


def test_the_page_maps_the_change_by_neighbours(tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text("{}")
    change = np.full((2, 3, 4), 0.1)
    change[:, 0, 0] = np.nan
    maps = NeighbourMap(5.6 * np.arange(4), 5.6 * np.arange(3), change, 1.0 - change)
    optics.save(replace(turning_psf(), neighbours=maps), tmp_path / "psf.h5")
    text = report.write(tmp_path).read_text(encoding="utf-8")
    assert "in blocks of 5.6 µm" in text and "by full-wave simulation" not in text
    drawn = {path.stem for path in (tmp_path / "figures").glob("neighbours_*.png")}
    assert drawn == {f"neighbours_{kind}_{p}" for kind in ("change", "kept") for p in "xy"}
    found = optics.load(tmp_path / "psf.h5").neighbours
    assert found is not None and np.array_equal(found.kept, maps.kept, equal_nan=True)


def test_rows_are_shown_if_they_are_of_this_mask(tmp_path: Path) -> None:
    row = CouplingRow(600.0, -20.0, "x", "y", "rcwa", 21, 1, 6.2, 0.812, 0.934, 0.03, 0.125, 0.01, 2.0)
    fullwave.save_coupling(fullwave.Coupling("abc", (row,)), tmp_path / "coupling.json")
    (tmp_path / "layout.oas").write_bytes(b"a mask")
    (tmp_path / "summary.json").write_text("{}")
    assert 'id="fullwave"' not in report.write(tmp_path).read_text(encoding="utf-8")
    sha = file_sha256(tmp_path / "layout.oas")
    fullwave.save_coupling(fullwave.Coupling(sha, (row,)), tmp_path / "coupling.json")
    text = report.write(tmp_path).read_text(encoding="utf-8")
    for cell in ("600, -20 along x", "rcwa", "21", "0.812", "0.934", "0.125"):
        assert cell in text
    # Rows of an earlier mask, beside those that the run solved for this one.
    fullwave.save_coupling(fullwave.Coupling(sha, (row,)), tmp_path / "orders.json")
    earlier = replace(row, x_um=500.0, coupling_error=0.3)
    fullwave.save_coupling(fullwave.Coupling("before", (earlier,)), tmp_path / "coupling.json")
    text = report.write(tmp_path).read_text(encoding="utf-8")
    assert "600, -20 along x" in text and "500, -20 along x" not in text


def test_a_damaged_patch_leaves_the_page_whole(tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text("{}")
    (tmp_path / "patch.h5").write_bytes(b"no HDF5")
    assert 'id="fullwave"' not in report.write(tmp_path).read_text(encoding="utf-8")


def test_pictures_show_the_sites_where_they_are(patch: fullwave.Patch) -> None:
    axes = figures.patch_phase(patch.full_wave, patch.x_um, patch.y_um, panel()[1], "By Meep")
    (image,) = axes.images
    np.testing.assert_allclose(image.get_extent(), (599.825, 601.925, -2.175, -0.775))
    np.testing.assert_allclose(image.get_array(), np.angle(patch.full_wave))
    assert image.get_clim() == pytest.approx((-np.pi, np.pi))
    axes = figures.patch_amplitude(patch.library, patch.x_um, patch.y_um, panel()[1], "By the library", largest=1.2)
    (image,) = axes.images
    assert image.get_clim() == (0.0, 1.2)
    np.testing.assert_allclose(image.get_array(), 1.0)


def test_orders_by_full_wave_stand_first_and_in_a_table(tmp_path: Path) -> None:
    rows = [
        OrderFigures(
            polarisation=p,  # type: ignore[arg-type]
            order=(m, 0),
            angle_x_deg=10.02 * m,
            angle_y_deg=0.0,
            efficiency=share,
            library_efficiency=0.91,
            error=0.007,
            wanted=True,
        )
        for p, m, share in (("x", 1, 0.787), ("y", -1, 0.89))
    ]
    solved = OrdersFigures(sites=(13, 1), windows=6, coupling_error=0.2, orders=tuple(rows))
    RunSummary(orders=solved, seconds={"orders": 54.0}).save(tmp_path / "summary.json")
    text = report.write(tmp_path).read_text(encoding="utf-8")
    head = text.split('id="fullwave"')[0]
    assert "79 · 89" in head and "each pillar among equal ones: 91 · 91" in head
    assert "repeat after 13 x 1" in text and "-10.02°, 0.00°" in text and "0.787" in text
    unsure = replace(solved, orders=tuple(replace(row, error=0.12) for row in rows))
    assert unsure.sentence.startswith("78.7 ± 10 % of x, 89.0 ± 10 % of y polarised light")
    RunSummary(orders=OrdersFigures(reason="no repeat")).save(tmp_path / "summary.json")
    assert "come from the library alone: no repeat" in report.write(tmp_path).read_text(encoding="utf-8")
