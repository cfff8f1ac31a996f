"""Loss chain, and decoded against true depth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab.report.accounts import depths_against_truth, loss_chain
from metafab.report.run_folder import RunFolder, open_run
from metafab.steps.optics import PsfFigures
from metafab.steps.summary import RunSummary
from tests.closed_form_run import decoded_image, raw_frame, turning_psf
from tests.conftest import MainJob


def test_depth_against_truth_reads_the_truth_at_the_same_place_on_the_sensor() -> None:
    """Truth on a larger grid, shifted by whole pixels, must give the same pairs."""
    decoded, raw = decoded_image(), raw_frame()
    run = RunFolder(Path(), decoded=decoded, raw=raw)
    same = depths_against_truth(run)
    assert same is not None
    np.testing.assert_allclose(same.true_m, [0.26, 0.33])
    np.testing.assert_allclose(same.decoded_m, [0.2604, 0.3291])
    np.testing.assert_allclose(same.error_m, [4e-4, 8e-4])
    assert raw.truth is not None
    padded = np.pad(raw.truth.depth_m, ((3, 9), (5, 2)), constant_values=np.nan)
    shifted = (decoded.origin_um[0] - 5 * 3.45, decoded.origin_um[1] - 3 * 3.45)
    truth = type(raw.truth)(padded, raw.truth.intensity_x, raw.truth.intensity_y, raw.truth.label)
    moved = type(raw)(raw.frame, raw.pixel_um, raw.origin_um, raw.read_noise_e, truth, shifted)
    other = depths_against_truth(RunFolder(Path(), decoded=decoded, raw=moved))
    assert other is not None
    for name, values in vars(same).items():
        np.testing.assert_array_equal(getattr(other, name), values)


def test_loss_chain_falls_and_names_its_comparison() -> None:
    psf, ideal = turning_psf(0.6), turning_psf(0.9)
    figures = PsfFigures.compared(psf, ideal, verified=np.ones(psf.depth_m.size, dtype=bool))
    summary = RunSummary(psf=replace(figures, transmitted_x=0.8, transmitted_y=0.7))
    chain = loss_chain(RunFolder(Path(), summary=summary, psf=psf, ideal_psf=ideal))
    assert [stage.share for stage in chain] == pytest.approx([1.0, 0.75, 0.6, 0.9])
    assert chain[-1].name.startswith("for comparison")


def test_error_bars_are_the_standard_errors_of_the_decoder(main_job: MainJob) -> None:
    """The segments of a real run, read from its file: every one has an error, and the depths agree within them."""
    pairs = depths_against_truth(open_run(main_job.folder))
    assert pairs is not None and pairs.error_m.size >= 3
    assert np.all(pairs.error_m > 0.0)
    # 0.2 % of the nearest depth: the decoder's bias on so small a lens is a few standard errors.
    assert np.all(np.abs(pairs.decoded_m - pairs.true_m) < 2e-3 * pairs.true_m + 3.0 * pairs.error_m)
