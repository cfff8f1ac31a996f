"""Printed sizes of the written mask, in the report of its run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab import report
from metafab.core.storage.files import file_sha256
from metafab.exposure import ExposureFigures, ExposureRecord, SizeErrors, save_record
from metafab.exposure.prediction import SizeMap, WindowPoint
from metafab.report.figures import exposure as figures
from metafab.report.style import panel

FIGURES = ExposureFigures(1000, 0.582, 1.84, -0.01, 0, 1.0, 1.0, 1, 0.401, 27.0, 0.1, 2.3, 4e-5, 0)
AFTER = replace(FIGURES, cd_error_rms_nm=0.0217, cd_error_max_nm=0.0652, dose_min=0.99, dose_max=1.05, classes=64)
AFTER = replace(AFTER, continuous_rms_nm=0.0193, continuous_max_nm=0.0481)


@pytest.fixture
def record() -> ExposureRecord:
    """A rim that prints 1 nm too small, and a correction that leaves nothing."""
    bias_nm = np.array([[np.nan, -1.0, np.nan], [-1.0, 0.4, -1.0]], dtype=np.float32)
    edges_nm = np.array([-1.5, -0.5, 0.5, 1.5])
    window = tuple(WindowPoint(p, 0.4 * p, np.hypot(0.4 * p, 0.3), 1.0 if p < -5.0 else 0.0) for p in (-6.0, 0.0, 6.0))
    plain = SizeErrors(FIGURES, np.array([150.0, 50.0, 0.0]), edges_nm, SizeMap(bias_nm, (10.0, 20.0)), window)
    after = replace(
        plain, figures=AFTER, cd_histogram=np.array([0.0, 200.0, 0.0]), size_map=SizeMap(0.0 * bias_nm, (10.0, 20.0))
    )
    return ExposureRecord("", "Monte Carlo <100 kV>", "dose", plain, after)


def test_the_page_shows_the_exposure_of_its_own_mask(record: ExposureRecord, tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text("{}", encoding="utf-8")
    assert 'id="exposure"' not in report.write(tmp_path).read_text(encoding="utf-8")
    (tmp_path / "layout.oas").write_bytes(b"the mask")
    save_record(replace(record, mask_sha256="of another"), tmp_path / "exposure.json")
    foreign = report.write(tmp_path).read_text(encoding="utf-8")
    assert "exposure.json is of another mask" in foreign
    assert not list((tmp_path / "figures").glob("exposure_*.png"))
    save_record(replace(record, mask_sha256=file_sha256(tmp_path / "layout.oas")), tmp_path / "exposure.json")
    text = report.write(tmp_path).read_text(encoding="utf-8")
    assert 'id="exposure"' in text
    for cell in (
        "one dose",
        "corrected doses",
        "0.582",
        "0.0217",
        "0.0193",
        "0.0481",
        "0.99 to 1.05",
        "Monte Carlo &lt;100 kV&gt;",
    ):
        assert cell in text
    drawn = {path.stem for path in (tmp_path / "figures").glob("exposure_*.png")}
    assert drawn == {f"exposure_{kind}" for kind in ("map_plain", "map_corrected", "histogram", "window")}
    (tmp_path / "exposure.json").write_text("{", encoding="utf-8")
    assert "exposure.json could not be read" in report.write(tmp_path).read_text(encoding="utf-8")


def test_figures_hold_the_data(record: ExposureRecord) -> None:
    assert record.corrected is not None
    parts = {"one dose": record.plain, "corrected doses": record.corrected}
    axes = figures.size_map(record.plain.size_map, panel()[1], "One dose", largest_nm=1.0)
    (image,) = axes.images
    np.testing.assert_array_equal(image.get_array().filled(np.nan), record.plain.size_map.bias_nm)
    assert image.get_clim() == (-1.0, 1.0)
    assert tuple(image.get_extent()) == (-15.0, 15.0, -20.0, 20.0)
    before, after = (patch.get_data() for patch in figures.size_histogram(parts, panel()[1]).patches)
    np.testing.assert_array_equal(before.values, [75.0, 25.0, np.nan])
    np.testing.assert_array_equal(after.values, [np.nan, 100.0, np.nan])
    axes = figures.process_window(parts, panel()[1])
    line = axes.lines[0]
    assert line.get_label() == "one dose"
    # Nothing prints at -6 %.
    np.testing.assert_allclose(line.get_ydata(), [np.nan, 0.0, 2.4])
    band = axes.collections[0].get_paths()[0].vertices
    at_zero = np.unique(np.round(band[band[:, 0] == 0.0, 1], 6))
    np.testing.assert_allclose(at_zero, [-0.3, 0.3])
