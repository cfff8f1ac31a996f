"""A lens that photographs nothing: the mask is made and verified on the axis, and no frame is taken."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab import library, run
from metafab.core.errors import InputError
from metafab.optics import Imaging, depth_nodes, field_tangents
from metafab.spec import Design, Optics, canonical_toml, load_design
from metafab.spec.terms import Lens
from metafab.steps import open_library
from metafab.steps.job import Job
from metafab.steps.optics import calibration_depths
from tests.main_job import SMALL


@pytest.fixture
def plain_lens() -> Design:
    whole = load_design(SMALL)
    return replace(
        whole,
        name="plain_lens",
        scene=None,
        phase=(Lens(),),
        device=replace(whole.device, aperture_um=40.0),
        verify=replace(whole.verify, depths_m=(0.003,)),
        mask=replace(whole.mask, formats=("oas",)),
    )


def test_only_the_depths_asked_for_are_computed(plain_lens: Design) -> None:
    imaging = Imaging.of(plain_lens)
    assert field_tangents(plain_lens, imaging) is None
    assert calibration_depths(plain_lens, imaging) == plain_lens.depths_m == (0.003,)
    assert len(calibration_depths(load_design(SMALL), imaging)) > depth_nodes(imaging, 0.0025, 0.0034, 1e-3).size


def test_what_needs_photons_asks_for_a_scene(tmp_path: Path) -> None:
    text = SMALL.read_text(encoding="utf-8").split("[scene]")[0].replace('"peak"', '"blind_information"')
    library_file = (SMALL.parent / "../unitcell_lib/sos_800nm.toml").resolve()
    design = tmp_path / "design.toml"
    design.write_text(text.replace("../unitcell_lib/sos_800nm.toml", str(library_file)), encoding="utf-8")
    with pytest.raises(InputError, match="needs a `scene`"):
        load_design(design)


def test_a_lens_without_a_scene_runs_to_its_report(tmp_path: Path, plain_lens: Design) -> None:
    assert "[scene]" not in canonical_toml(plain_lens)
    summary = run.run(plain_lens, tmp_path)
    skipped = {entry.step: entry.why for entry in summary.skipped}
    assert "[tolerance]" in skipped.pop("tolerance") and "[process.exposure]" in skipped.pop("exposure")
    no_scene = dict.fromkeys(("capture", "decode"), "the design has no scene to photograph")
    assert "focuses light" in skipped.pop("orders")
    assert skipped == {"lights": "the design serves one wavelength", **no_scene}
    assert summary.psf is not None and summary.capture is None and summary.decode is None
    # Stigmatic for parallel light, used at a finite depth: most of what the pillars let through is in the window.
    transmitted = library.quality(open_library(Job(plain_lens, tmp_path))).mean_transmittance
    assert 0.5 * transmitted < summary.psf.efficiency_x[0] <= 1.0
    sources = {line.source for line in summary.error_budget}
    assert "pupil reduction and sampling" in sources
    assert not sources & {"decoder", "depth interpolation", "field interpolation"}, "there is no image to be wrong in"
    assert (tmp_path / "report.html").is_file()


def test_a_thin_ring_of_light_has_a_focus_but_no_polynomials(tmp_path: Path, plain_lens: Design) -> None:
    x_um = np.linspace(-10.5, 10.5, 211)
    np.save(tmp_path / "ring.npy", 1.0 * (np.hypot(x_um, x_um[:, None]) > 9.7))
    optics = Optics(amplitude_file=tmp_path / "ring.npy", amplitude_pitch_um=0.1)
    ring = replace(plain_lens, device=replace(plain_lens.device, aperture_um=20.0), optics=optics)
    merit = run.run(ring, tmp_path / "run").merit
    assert merit is not None and merit.focus is not None
    assert merit.aberrations is None
