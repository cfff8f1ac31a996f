"""Copies out of focus share the base dose of those in focus; a run names why it predicts no printed sizes."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from metafab.core.errors import InputError
from metafab.core.parallel.work import Work
from metafab.library import Library, save
from metafab.spec import Dose, load_design
from metafab.spec.mask import Copy
from metafab.steps import Job, write_layout
from metafab.steps.exposure import EXPOSURE, CopyFigures, errors_of_copies_nm, expose_mask, made_mask
from tests.main_job import SMALL

FURTHER = """
[[mask.copies]]
at_um = [0.0, 0.0]
[[mask.copies]]
at_um = [40.0, 0.0]
focus_um = 6.0
[process.exposure]
preset = "hsq_sos_100kv"
convergence_mrad = 12.0
"""


def test_a_copy_out_of_focus_is_exposed_at_the_base_dose_of_the_others(smooth_library: Library, tmp_path: Path) -> None:
    """51 nm of blur in place of 5; without a common base dose both copies would print at size in the mean."""
    save(smooth_library, tmp_path / "library.h5")
    text = SMALL.read_text(encoding="utf-8").replace("../unitcell_lib/sos_800nm.toml", "library.h5")
    text = text.replace("aperture_um = 200.0", "aperture_um = 20.0").replace('optimise = "peak"', 'optimise = "none"')
    (tmp_path / "design.toml").write_text(text + FURTHER, encoding="utf-8")
    design = load_design(tmp_path / "design.toml")
    write_layout(Job(design, tmp_path))
    sharp, blurred = (
        expose_mask(tmp_path / "layout.oas", design, Work(), copy=copy).exposure.figures for copy in (1, 2)
    )
    assert blurred.base_over_clearing_dose == pytest.approx(sharp.base_over_clearing_dose, rel=1e-12)
    assert abs(sharp.cd_bias_nm) < 0.1
    assert abs(blurred.cd_bias_nm) > 1.0


def test_a_copy_that_does_not_print_has_no_size_errors() -> None:
    """Its errors counted as 0, then as NaN of all."""
    none = CopyFigures(1, 0.01, math.nan, math.nan, 9, 0.01, 0.01, 1)
    printed = [
        replace(none, copy=copy, cd_error_rms_nm=rms, cd_error_max_nm=5.0, unprinted=0)
        for copy, rms in ((2, 3.0), (3, 4.0))
    ]
    assert errors_of_copies_nm([none, *printed]) == pytest.approx((math.sqrt(12.5), 5.0))
    assert all(map(math.isnan, errors_of_copies_nm([none])))


def test_a_run_leaves_out_an_exposure_that_cannot_be_predicted() -> None:
    """A focus matrix is written before the convergence is known that follows from it."""
    design = load_design(SMALL.with_name("helix_exposed.toml"))
    assert EXPOSURE.not_needed(design) is None
    cases: list[tuple[dict[str, Any], str]] = [
        ({"tone": "inverted"}, "'inverted'"),
        ({"dose": Dose(by="proximity", classes=8)}, "dose classes"),
        ({"copies": (Copy((0.0, 0.0), focus_um=2.0), Copy((300.0, 0.0)))}, "convergence_mrad"),
        ({"formats": ()}, "no mask"),
    ]
    for change, why in cases:
        assert why in (EXPOSURE.not_needed(replace(design, mask=replace(design.mask, **change))) or "")
    in_focus = replace(design.mask, copies=(Copy((0.0, 0.0)), Copy((300.0, 0.0), focus_um=2.0)))
    assert EXPOSURE.not_needed(replace(design, mask=in_focus)) is None


@pytest.mark.parametrize(
    ("bias_nm", "message"), [(-400.0, "none is left at a bias of -400 nm"), (-90.0, "their printed corners")]
)
def test_an_etch_that_leaves_too_little_names_itself(
    bias_nm: float, message: str, smooth_library: Library, tmp_path: Path
) -> None:
    save(smooth_library, tmp_path / "library.h5")
    text = SMALL.read_text(encoding="utf-8").replace("../unitcell_lib/sos_800nm.toml", "library.h5")
    text = text.replace("aperture_um = 200.0", "aperture_um = 20.0").replace('optimise = "peak"', 'optimise = "none"')
    text += f'[process.exposure]\npreset = "hsq_sos_100kv"\n[process.etch]\nbias_nm = {bias_nm}\n'
    (tmp_path / "design.toml").write_text(text, encoding="utf-8")
    design = load_design(tmp_path / "design.toml")
    job = Job(design, tmp_path)
    write_layout(job)
    with pytest.raises(InputError, match=message) as refused:
        made_mask(job, tmp_path / "layout.oas", "plain")
    assert refused.value.faults[0].field == "process.etch"
