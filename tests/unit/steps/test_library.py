"""Places of the libraries of a design."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from metafab.spec import Light, load_design
from metafab.steps.job import Job
from metafab.steps.library import library_path
from metafab.steps.optics.lights import LIGHTS
from tests.main_job import ROOT


def test_each_wavelength_has_files_of_its_own(tmp_path: Path) -> None:
    """Lines of a laser may differ in the seventh digit."""
    design = load_design(ROOT / "layouts" / "rgb_metalens.toml")
    lights = (Light(460.0), Light(532.00012), Light(532.00034), Light(540.0))
    job = Job(replace(design, light=lights), tmp_path)
    names = [library_path(job.at_light(light)).name for light in lights]
    assert names[0] == "tio2_circles_rgb_460nm.h5" and names[-1] == "tio2_circles_rgb.h5"
    assert len(set(names)) == len(set(LIGHTS.outputs(job))) == len(lights)
