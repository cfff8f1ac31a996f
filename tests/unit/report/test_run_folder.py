"""A run folder is opened by the readers of the rooms that wrote it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab import camera, decode, library, mask, optics
from metafab.layout import PillarMap, lattice_of
from metafab.library import Library
from metafab.report.run_folder import open_run
from metafab.report.write import write
from metafab.spec import Design, canonical_toml
from tests.closed_form_run import decoded_image, raw_frame, run_summary, turning_psf


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, smooth_library: Library, small_design: Design) -> Path:
    """A run folder written by the rooms themselves: one pillar size all over the small design's lattice."""
    path = tmp_path_factory.mktemp("run")
    (path / "design.toml").write_text(canonical_toml(small_design), encoding="utf-8")
    lattice = lattice_of(small_design)
    sizes = np.array([[0, 0], [300, 400]], dtype=np.int32)
    whole = np.ones(lattice.shape, dtype=np.uint16)
    mask.write(PillarMap.from_array(lattice, sizes, whole, small_design.numerics.tile_sites), path, small_design)
    library.save(smooth_library, path / "lib.h5")
    optics.save(turning_psf(0.6), path / "psf.h5")
    optics.save(turning_psf(0.9), path / "ideal_psf.h5")
    camera.save(raw_frame(), path / "raw.h5")
    decode.save(decoded_image(), path / "decoded.h5")
    summary = run_summary()
    assert summary.library is not None
    replace(summary, library=replace(summary.library, file=str(path / "lib.h5"))).save(path / "summary.json")
    return path


def test_everything_written_is_read(folder: Path, smooth_library: Library) -> None:
    run = open_run(folder)
    assert set(run.notes) == {"phases", "study"}, "phase.h5 and its study were not written; all else was"
    assert run.name == "helix_small"
    assert run.library is not None and run.pillars is not None and run.psf is not None
    assert run.raw is not None and run.decoded is not None and run.ideal_psf is not None
    np.testing.assert_array_equal(run.library.t_xx, smooth_library.t_xx)
    index = run.pillars.to_array()
    np.testing.assert_array_equal(np.unique(run.pillars.size_nm()[index].reshape(-1, 2), axis=0), [[150.0, 200.0]])
    np.testing.assert_allclose(run.psf.psf, turning_psf(0.6).psf, rtol=1e-6)
    np.testing.assert_array_equal(run.decoded.segment, decoded_image().segment)


def test_page_of_written_files(folder: Path) -> None:
    text = write(folder).read_text(encoding="utf-8")
    assert "phase.h5 is not in the run folder" in text
    assert 'class="note"' in text
    assert "helix_small" in text
    for name in ("layout.gds", "psf.h5", "decoded.h5"):
        assert f'href="{name}"' in text
    assert sorted(path.name for path in folder.iterdir() if path.name.startswith(".")) == [], "no part of a file stays"


def test_a_truncated_file_costs_its_section_only(folder: Path, tmp_path: Path) -> None:
    for path in folder.iterdir():
        if path.is_file():
            (tmp_path / path.name).write_bytes(path.read_bytes())
    psf = (tmp_path / "psf.h5").read_bytes()
    (tmp_path / "psf.h5").write_bytes(psf[: len(psf) // 2])
    (tmp_path / "layout.oas").write_bytes(b"%SEMI-OASIS\r\n")
    run = open_run(tmp_path)
    assert run.psf is None and "psf.h5" in run.notes["psf"]
    assert run.pillars is None and "layout.oas" in run.notes["mask"]
    assert run.decoded is not None and run.ideal_psf is not None
