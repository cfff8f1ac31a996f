"""Designs that turned pillars cannot follow are refused by name, all keys at once."""

from __future__ import annotations

import dataclasses

import pytest

from metafab.core.errors import InputError
from metafab.spec import Design, Optics, SceneObject
from metafab.spec.terms import Grating, SplitLens
from metafab.spec.turned import require_turnable


def test_a_design_with_rectangles_is_accepted(small_design: Design) -> None:
    require_turnable(small_design)


def test_every_key_that_is_not_available_is_named(small_design: Design) -> None:
    cell = dataclasses.replace(small_design.unit_cell.cell, shape="ellipse")
    assert small_design.scene is not None
    moving = dataclasses.replace(small_design.scene.objects[0], velocity_m_per_s=(0.1, 0.0, 0.0))
    split = SplitLens(angle_deg=8.0, object_depth_m=0.003)
    design = dataclasses.replace(
        small_design,
        unit_cell=dataclasses.replace(small_design.unit_cell, cell=cell),
        phase=(split, Grating(angle_deg=1.0)),
        rules=dataclasses.replace(
            small_design.rules, gap_rule="pairs", polarisation_independent=True, retardance="kept"
        ),
        mask=dataclasses.replace(small_design.mask, tone="inverted"),
        optics=Optics(filter_fwhm_nm=10.0, substrate_um=300.0),
        scene=dataclasses.replace(small_design.scene, objects=(moving,), exposure_s=0.01, row_time_s=1e-5),
    )
    with pytest.raises(InputError) as refusal:
        require_turnable(design)
    assert [fault.field for fault in refusal.value.faults] == [
        "unit_cell.cell.shape",
        "rules.gap_rule",
        "rules.polarisation_independent",
        "rules.retardance",
        "mask.tone",
        "optics.filter_fwhm_nm",
        "optics.substrate_um",
        "phase[0].object_depth_m",
        "phase[1].term",
        "scene.exposure_s",
        "scene.row_time_s",
    ]
    assert str(refusal.value).count("not available with turned pillars") == len(refusal.value.faults)


def test_weights_of_sizes_and_drawn_corners_are_not_available(small_design: Design) -> None:
    cell = dataclasses.replace(small_design.unit_cell.cell, corner_radius_nm=20.0)
    design = dataclasses.replace(
        small_design,
        unit_cell=dataclasses.replace(small_design.unit_cell, cell=cell),
        rules=dataclasses.replace(small_design.rules, cd_sigma_nm=5.0),
        mask=dataclasses.replace(small_design.mask, draw_corners=True),
    )
    with pytest.raises(InputError) as refusal:
        require_turnable(design)
    assert {fault.field for fault in refusal.value.faults} == {"rules.cd_sigma_nm", "mask.draw_corners"}


def test_images_without_a_split_are_refused(small_design: Design) -> None:
    unsplit = dataclasses.replace(small_design, phase=(small_design.phase[0],))
    with pytest.raises(InputError, match="split_lens"):
        require_turnable(unsplit)


def test_more_than_full_polarisation_is_refused() -> None:
    with pytest.raises(InputError, match="longer than 1"):
        SceneObject(depth_m=1.0, stokes=(0.8, 0.8, 0.0))
