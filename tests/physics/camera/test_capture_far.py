"""Five centimetres at two hundred metres, without a mask: turn and resolution against closed forms, and a frame."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab import camera, decode, optics, phase
from metafab.layout import Lattice, lattice_of, sampling_lattice
from metafab.phase import propose
from metafab.spec import Design, SceneObject, load_design

DESIGN = Path(__file__).parents[3] / "layouts" / "helix_5cm.toml"


@pytest.fixture(scope="module")
def far() -> Design:
    return load_design(DESIGN)


def test_five_centimetres_tell_depth_from_100_to_300_m() -> None:
    found = propose(100.0, 300.0, aperture_um=50000.0, wavelength_um=0.8, zones=[5], exponents=[0.5])[0]
    assert found.rotation_deg_per_dioptre == pytest.approx(-225.0 / 5 * 25.0**2, rel=1e-3)
    # A plain spiral's lobe swings about the law by some degrees.
    law_deg = 225.0 / 5 * 25.0**2 * (1.0 / 100.0 - 1.0 / 300.0)
    assert found.rotation_deg == pytest.approx(law_deg, abs=4.0)
    assert (np.diff(found.phi_deg) > 0.0).all()
    assert found.focus_depth_m == pytest.approx(150.0)
    # The paper's aperture at 1/625 of the depths is the same pupil: all bounds in proportion.
    small = propose(0.16, 0.48, aperture_um=2000.0, wavelength_um=0.8, zones=[5], exponents=[0.5])[0]
    np.testing.assert_allclose(found.crlb_m, 625.0 * small.crlb_m, rtol=1e-9)
    # A radian of defocus at the rim is the scale of what can be resolved: lambda z^2 / (pi R^2) = 16 m at 200 m.
    at_200_m = float(np.interp(200.0, found.depth_m, found.crlb_m))
    radian_m = 0.8e-6 / (np.pi * 0.025**2) * 200.0**2
    assert 1e-3 * radian_m < at_200_m < 0.1 * radian_m


def test_the_sites_of_target_phases_are_as_coarse_as_the_lens_is_steep(far: Design) -> None:
    """The rim of Eq. 3 bends light by theta and the numerical aperture: lambda / (2 sin) is a turn in two sites."""
    profile, whole = phase.profile_of(far), lattice_of(far)
    chosen = sampling_lattice(profile, far)
    pitch_um = chosen.period_dbu[0] * chosen.database_unit_nm * 1e-3
    steepest = np.sin(np.radians(1.0)) + 25.0 / np.hypot(500.0, 25.0)
    assert 0.5 < pitch_um / (0.5 * far.wavelength_um / steepest) < 1.05
    assert chosen.period_dbu[0] % (2 * whole.period_dbu[0]) == 0
    assert 0.0 <= far.device.aperture_um - chosen.shape[0] * pitch_um < pitch_um


@pytest.mark.parametrize("angle_deg", [1.0, 8.0])
def test_coarse_sites_have_the_pair_of_the_whole_lattice(far: Design, angle_deg: float) -> None:
    """A lens of the same steepness, small enough to be summed pillar by pillar: within the error that is stated."""
    split = replace(far.phase[1], angle_deg=angle_deg)
    spiral = replace(far.phase[0], optimise="none")
    device = replace(far.device, aperture_um=1500.0, focal_length_mm=15.0)
    sensor = replace(far.sensor, focus_depth_m=0.2)
    lens = replace(far, device=device, phase=(spiral, split), sensor=sensor)
    profile = phase.profile_of(lens)
    lattices = sampling_lattice(profile, lens), lattice_of(lens)
    assert lattices[0].period_dbu[0] > lattices[1].period_dbu[0]
    coarse, fine = (
        optics.psf(
            optics.ideal_field(profile, lattice, device),
            optics.Imaging.of(lens),
            (0.19, 0.21),
            optics.PsfNumerics(window_px=48),
        )
        for lattice in lattices
    )
    # A zone's rim and the aperture's are squared off by the sites: a few in a thousand stand on the wrong side.
    assert optics.relative_l2(coarse.psf, fine.psf) < 5e-3
    np.testing.assert_allclose(coarse.efficiency, fine.efficiency, atol=2e-3)
    np.testing.assert_allclose(coarse.phi_deg, fine.phi_deg, atol=0.2)


def test_five_centimetres_decode_a_street_at_200_m(far: Design) -> None:
    """The paper expects a mean error of depth well below 1 % (its Supplementary 6)."""
    pieces = [
        SceneObject(depth_m=z, centre=(x, 0.0), size=(9e-4, 1.4e-3), polarisation_contrast=contrast)
        for z, x, contrast in ((155.0, -1e-3, 1.0), (200.0, 0.0, 2.5), (245.0, 1e-3, 1.0))
    ]
    assert far.scene is not None
    scene = replace(far.scene, objects=tuple(pieces), field_px=(240, 448))
    lens = replace(far, scene=scene, verify=replace(far.verify, field_points=(4, 3)))
    imaging = optics.Imaging.of(lens)
    # Behind lens and split the phase is slow: sites of 20 um change the pair by 5e-5 and its time by much.
    lattice = Lattice(period_dbu=(40000, 40000), shape=(2500, 2500), database_unit_nm=0.5)
    source = optics.ideal_field(phase.profile_of(lens), lattice, lens.device)
    depths_m = optics.depth_nodes(imaging, 145.0, 265.0, 1e-3)
    calibration = optics.psf(source, imaging, depths_m, field_tangents=optics.field_tangents(lens, imaging))
    # The frame knows neither the calibration's depths nor its directions.
    finer = replace(lens, verify=replace(lens.verify, field_points=(7, 4)))
    shown = optics.psf(
        source,
        imaging,
        scene.depths_m,
        optics.PsfNumerics(window_px=80),
        field_tangents=optics.field_tangents(finer, imaging),
    )
    image = decode.decode(camera.capture(scene, shown), calibration)
    assert image.figures.share_decoded > 0.98
    assert image.figures.worst_object_error < 3e-3
    assert image.figures.contrast_error < 0.02
    assert image.nmae is not None
    assert image.nmae < 0.02
