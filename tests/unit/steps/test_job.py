"""Jobs of slanting light: directions of its objects, and fingerprints of its PSFs."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import h5py
import pytest

from metafab.core.errors import InputError
from metafab.spec import Design, Light, Material
from metafab.spec.cell import Axes
from metafab.steps.job import Job, light_tangent
from metafab.steps.optics import save_psf
from tests.closed_form_run import turning_psf


def test_light_refracts_into_the_air_and_its_object_stands_on_the_other_side(small_design: Design) -> None:
    light = Light(800.0, angle_x_deg=20.0)
    n = small_design.unit_cell.materials.substrate.n
    assert n is not None
    angle = math.asin(n * math.sin(math.radians(20.0)))
    assert light_tangent(small_design, light) == pytest.approx((-math.tan(angle), 0.0))
    from_air = replace(small_design.unit_cell.illumination, side="ambient")
    design = replace(small_design, unit_cell=replace(small_design.unit_cell, illumination=from_air))
    assert light_tangent(design, Light(800.0, angle_y_deg=-20.0)) == pytest.approx((0.0, math.tan(math.radians(20.0))))
    # Sapphire with its axis along x: the angle is that of ordinary light, as in the library.
    materials = replace(small_design.unit_cell.materials, substrate=Material(n=1.768, n_y=1.7601, n_z=1.7601))
    sapphire = replace(small_design, unit_cell=replace(small_design.unit_cell, materials=materials))
    assert light_tangent(sapphire, light) == light_tangent(small_design, light)
    with pytest.raises(InputError, match=r"light\.angle_x_deg.*below 34\.\d+ deg in a medium of index 1\.76,"):
        light_tangent(small_design, replace(light, angle_x_deg=40.0))


def test_psfs_of_unlike_directions_have_unlike_fingerprints(small_design: Design, tmp_path: Path) -> None:
    cell = small_design.unit_cell
    swept = replace(cell, sweep=replace(cell.sweep, axes=Axes(angle_x_deg=(0.0, 20.0))), neighbours=None)
    lights = (Light(800.0), Light(800.0, angle_x_deg=10.0), Light(800.0, angle_x_deg=20.0))
    job, marks, path = Job(replace(small_design, unit_cell=swept, light=lights), tmp_path), set(), tmp_path / "psf.h5"
    for light in lights:
        save_psf(job.at_light(light), turning_psf(), None, path)
        with h5py.File(path) as file:
            marks.add(file.attrs["inputs_sha256"])
    assert len(marks) == 3
