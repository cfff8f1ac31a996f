"""Numerics for a wanted depth error: the law of depth, and what the allotted field points leave."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from metafab.cli.app import open_job
from metafab.core.errors import InputError
from metafab.core.parallel.work import Work
from metafab.layout import lattice_of
from metafab.optics import Imaging, PsfNumerics, Source, field_tangents, ideal_field, psf, relative_l2
from metafab.optics.depth_target import NUMERICAL_SHARE, depth_slope, with_depth_target
from metafab.phase import profile_of
from metafab.spec import Design, canonical_toml, load_design
from metafab.spec.terms import SpiralZones, SplitLens
from tests.main_job import ROOT

TEXT = (ROOT / "layouts" / "helix_small.toml").read_text(encoding="utf-8")


@cache
def plain() -> Design:
    """The small lens with zones that are not optimised."""
    design = load_design(ROOT / "layouts" / "helix_small.toml")
    return replace(design, phase=(SpiralZones(zones=4, exponent=0.5), SplitLens(angle_deg=8.0)))


@cache
def light() -> Source:
    return ideal_field(profile_of(plain()), lattice_of(plain()), plain().device)


def asking(depth_error: float) -> Design:
    return replace(plain(), verify=replace(plain().verify, target_depth_error=depth_error))


@pytest.mark.parametrize("depth_m", [0.0026, 0.0033])
def test_psfs_change_with_depth_as_the_defocus_over_the_aperture(depth_m: float) -> None:
    """Measured: 1.020 to 1.042 of the closed form, for zones that are not optimised."""
    near, far = depth_m * 0.999, depth_m * 1.001
    pair = psf(
        light(),
        Imaging.of(plain()),
        (near, depth_m, far),
        PsfNumerics(window_px=96, target_error=1e-4),
        work=Work(workers=1),
    ).psf
    measured = relative_l2(pair[:, 2], pair[:, 0]) / 0.002
    assert measured == pytest.approx(depth_slope(plain(), depth_m), rel=0.05)


def test_the_slope_is_a_closed_form_for_discs_and_rings() -> None:
    design = plain()
    rim_rad = math.pi * 100.0**2 / (0.8 * 3000.0)
    assert depth_slope(design, 0.003) == pytest.approx(rim_rad / math.sqrt(12.0), rel=2e-3)
    ring = replace(design.device, aperture_shape="ring", inner_um=120.0)
    assert depth_slope(replace(design, device=ring), 0.003) == pytest.approx(0.64 * rim_rad / math.sqrt(12.0), rel=5e-3)


@pytest.mark.parametrize("depth_error", [1e-2, 3e-2])
def test_field_points_keep_the_error_that_is_left_to_the_field(depth_error: float) -> None:
    """Half of the numerical error is that of the field in the mean; an outermost cell has up to twice as much."""
    design = with_depth_target(asking(depth_error))
    imaging, depths_m = Imaging.of(design), (0.0029,)
    numerics = PsfNumerics(window_px=64, target_error=design.verify.target_error)
    grid = field_tangents(design, imaging)
    pair = psf(light(), imaging, depths_m, numerics, field_tangents=grid, work=Work(workers=1))
    allowed = 0.5 * NUMERICAL_SHARE * depth_error * depth_slope(design, 0.0033)
    assert 0.0 < pair.details.field_interpolation_error <= 2.0 * allowed
    assert pair.error.max() <= 0.5 * allowed


def test_a_smaller_depth_error_needs_finer_numerics() -> None:
    asked = [with_depth_target(asking(error)).verify for error in (3e-2, 3e-3, 3e-4)]
    assert np.all(np.diff([verify.target_error for verify in asked]) < 0.0)
    assert np.all(np.diff([verify.field_points for verify in asked], axis=0) > 0)


def test_a_design_that_asks_for_nothing_is_left_alone() -> None:
    assert with_depth_target(plain()) is plain()


def test_errors_below_what_single_precision_allows_are_refused() -> None:
    with pytest.raises(InputError, match="target_depth_error"):
        with_depth_target(asking(1e-8))


def test_a_device_without_a_scene_has_no_depth_to_err_by(tmp_path: Path) -> None:
    file = tmp_path / "design.toml"
    text = TEXT[: TEXT.index("[scene]")].replace("../unitcell_lib", str(ROOT / "unitcell_lib"))
    file.write_text(text.replace("[verify]", "[verify]\ntarget_depth_error = 0.01"), encoding="utf-8")
    with pytest.raises(InputError, match="needs a `scene`"):
        load_design(file)


def test_commands_and_the_canonical_design_take_the_targets_of_the_depth_error(tmp_path: Path) -> None:
    file = tmp_path / "design.toml"
    text = TEXT.replace("../unitcell_lib", str(ROOT / "unitcell_lib"))
    file.write_text(text.replace("[verify]", "[verify]\ntarget_depth_error = 0.01"), encoding="utf-8")
    job = open_job(file, tmp_path, Work())
    assert job.design.verify.target_error != load_design(file).verify.target_error
    file.write_text(canonical_toml(job.design, tmp_path), encoding="utf-8")
    assert open_job(file, tmp_path, Work()).design == job.design
