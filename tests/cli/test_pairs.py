"""``metafab psf`` for a decoder's calibration and for one scene's frames: over the right depths and directions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab import camera, decode
from metafab.core.errors import InputError
from metafab.optics import Psf
from metafab.spec import Design
from metafab.spec.terms import SpiralZones
from metafab.steps import optics
from metafab.steps.job import Job
from tests.main_job import SMALL, metafab


@pytest.fixture(scope="module")
def job(small_design: Design, tmp_path_factory: pytest.TempPathFactory) -> Job:
    """The small lens without a mask and without optimisation, over a narrow field."""
    assert small_design.scene is not None
    terms = tuple(replace(t, optimise="none") if isinstance(t, SpiralZones) else t for t in small_design.phase)
    scene = replace(small_design.scene, objects=small_design.scene.objects[1:2], field_px=(64, 64))
    design = replace(
        small_design, phase=terms, scene=scene, mask=replace(small_design.mask, formats=()),
        verify=replace(small_design.verify, field_points=(5, 4), depths_m=(0.0028, 0.003)),
    )  # fmt: skip
    return Job(design, tmp_path_factory.mktemp("pairs"))


@pytest.fixture(scope="module")
def calibration(job: Job) -> Psf:
    return optics.calibration(job, None)


@pytest.fixture(scope="module")
def exact(job: Job) -> Psf:
    assert job.design.scene is not None
    return optics.scene_pair(job, None, job.design.scene)


def test_a_calibration_covers_the_scene(job: Job, calibration: Psf) -> None:
    assert job.design.scene is not None
    assert calibration.depth_m[0] < min(job.design.scene.depths_m)
    assert calibration.depth_m[-1] > max(job.design.scene.depths_m)
    assert set(job.design.verify.depths_m) <= set(calibration.depth_m.tolist())
    assert calibration.field is not None
    assert (calibration.field.tangent_x.size, calibration.field.tangent_y.size) == (5, 4)


def test_a_scenes_own_pair_is_at_its_very_depths_and_on_finer_directions(job: Job, exact: Psf) -> None:
    assert job.design.scene is not None
    np.testing.assert_array_equal(exact.depth_m, job.design.scene.depths_m)
    assert exact.field is not None
    assert exact.field.tangent_x.size >= 8
    assert exact.details.field_interpolation_error <= 3e-3


def test_frames_of_the_one_are_decoded_by_the_other(job: Job, calibration: Psf, exact: Psf) -> None:
    assert job.design.scene is not None
    image = decode.decode(camera.capture(job.design.scene, exact), calibration)
    assert image.figures.object_error < 0.01
    assert image.figures.share_decoded > 0.95


def test_a_design_without_a_scene_has_no_calibration(job: Job) -> None:
    with pytest.raises(InputError, match="`scene`"):
        optics.calibration(Job(replace(job.design, scene=None), job.folder), None)


@pytest.mark.parametrize(
    "options",
    [
        ("--calibration", "--scene", SMALL),
        ("--calibration", "--pixel-um", "2"),
        ("--scene", SMALL, "--depths-m", "0.003"),
    ],
)
def test_options_that_answer_the_same_are_refused(tmp_path: Path, options: tuple[str | Path, ...]) -> None:
    answer = metafab("psf", "--ideal", "--design", SMALL, *options, "-o", tmp_path / "psf.h5")
    assert answer.code == 2
    assert "sets itself" in answer.stderr
    assert not (tmp_path / "psf.h5").exists()
