"""The page's section on the decoded image: its figures against the truth, and doubts about the calibration."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from metafab.report.run_folder import RunFolder
from metafab.report.sections.images import imaging
from metafab.steps.images import DecodeFigures
from metafab.steps.summary import RunSummary
from tests.closed_form_run import decoded_image, raw_frame

FIGURES = DecodeFigures(nmae=0.00398, segments=(), seconds=0.09, psnr_x_db=27.2, ssim_x=0.854)


def _section(figures: DecodeFigures) -> str:
    return imaging(RunFolder(Path(), summary=RunSummary(decode=figures), raw=raw_frame(), decoded=decoded_image()), {})


def test_what_is_known_against_the_truth_is_told_and_nothing_else() -> None:
    page = _section(FIGURES)
    for text in ("27.2", "PSNR of I_x / dB", "0.854", "0.00398"):
        assert text in page
    assert "contrast of the objects" not in page


def test_a_camera_frame_is_judged_by_no_truth() -> None:
    page = _section(DecodeFigures(nmae=None, segments=(), seconds=0.1))
    assert "against the scene" not in page


def test_a_doubted_calibration_is_said() -> None:
    doubt = "the twins differ by 12 % of their power: is this the camera's calibration?"
    assert "12 % of their power" in _section(replace(FIGURES, warning=doubt))
    assert "of their power:" not in _section(FIGURES)
