"""The full-Stokes step refuses what it cannot do before any work."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from metafab.core.errors import InputError
from metafab.spec import Design
from metafab.steps.job import Job
from metafab.steps.stokes import full_stokes


def test_motion_is_refused(small_design: Design, tmp_path: Path) -> None:
    assert small_design.scene is not None
    moving = dataclasses.replace(small_design.scene.objects[0], velocity_m_per_s=(0.1, 0.0, 0.0))
    scene = dataclasses.replace(small_design.scene, objects=(moving,), exposure_s=0.01)
    job = Job(dataclasses.replace(small_design, scene=scene), tmp_path)
    with pytest.raises(InputError, match="exposure_s"):
        full_stokes(job, row_angle_deg=8.0, angles=8, size_step_nm=20.0)
    assert not any(tmp_path.iterdir())


def test_inverted_masks_and_other_shapes_are_refused_together(small_design: Design, tmp_path: Path) -> None:
    mask = dataclasses.replace(small_design.mask, tone="inverted")
    rules = dataclasses.replace(small_design.rules, gap_rule="pairs")
    job = Job(dataclasses.replace(small_design, mask=mask, rules=rules), tmp_path)
    with pytest.raises(InputError) as refusal:
        full_stokes(job, row_angle_deg=8.0, angles=8, size_step_nm=20.0)
    assert [fault.field for fault in refusal.value.faults] == ["rules.gap_rule", "mask.tone"]
    assert not any(tmp_path.iterdir())
