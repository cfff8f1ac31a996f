"""Records of exposures survive their file; damaged ones are refused whole."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from metafab.exposure import ExposureRecord, SizeErrors, expose, load_record, save_record
from tests.physics.exposure.conftest import BEAM, disc, pattern


@pytest.fixture(scope="module")
def record() -> ExposureRecord:
    lens = pattern(np.array([(150.0, 200.0), (120.0, 180.0)]), disc(90, 2))
    plain, corrected = (SizeErrors.of(expose(lens, BEAM, correction=kind)) for kind in ("none", "dose"))
    return ExposureRecord("abc", "assumption", "dose", plain, corrected)


def test_a_record_survives_its_file(record: ExposureRecord, tmp_path: Path) -> None:
    save_record(record, tmp_path / "exposure.json")
    loaded = load_record(tmp_path / "exposure.json")
    assert loaded is not None and loaded.corrected is not None
    assert (loaded.mask_sha256, loaded.correction) == ("abc", "dose")
    assert loaded.plain.figures == record.plain.figures
    assert loaded.plain.window == record.plain.window
    assert loaded.plain.size_map.block_um == record.plain.size_map.block_um
    np.testing.assert_array_equal(loaded.plain.size_map.bias_nm, record.plain.size_map.bias_nm)
    assert np.isnan(loaded.plain.size_map.bias_nm[0, 0]), "no pillar stands in the corner"
    np.testing.assert_array_equal(loaded.corrected.cd_histogram, record.corrected.cd_histogram)
    # Two sides of each printed pillar.
    assert loaded.corrected.cd_histogram.sum() == 2 * loaded.corrected.figures.pillars


@pytest.mark.parametrize(
    ("key", "value"),
    [("cd_histogram", [1.0, 2.0]), ("size_map", {"bias_nm": [1.0], "block_um": [1.0, 1.0]}), ("window", [])],
)
def test_damaged_records_are_refused_whole(key: str, value: object, record: ExposureRecord, tmp_path: Path) -> None:
    path = tmp_path / "exposure.json"
    save_record(record, path)
    table = json.loads(path.read_text(encoding="utf-8"))
    table["plain"][key] = value
    path.write_text(json.dumps(table), encoding="utf-8")
    assert load_record(path) is None
    path.write_text("{", encoding="utf-8")
    assert load_record(path) is None
    assert load_record(tmp_path / "missing.json") is None
