"""Full-Stokes imaging: conventions of polarisation, Jones targets, turned pillars, their file, and decoded scenes."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from metafab.stokes import mask
from metafab.stokes.assign import turned
from metafab.stokes.decode import StokesImage
from pydantic import ValidationError

from metafab import stokes
from metafab.core.conventions import ComplexArray
from metafab.core.errors import InputError
from metafab.layout import lattice_of
from metafab.library.library import Library
from metafab.optics import Imaging
from metafab.spec import Design, Scene, SceneObject
from metafab.steps import full_stokes
from metafab.steps.job import Job

ANGLES = 8


@pytest.fixture(scope="module")
def design(small_design: Design) -> Design:
    """A quarter of the small lens' aperture, with room for turned pillars."""
    device = dataclasses.replace(small_design.device, aperture_um=50.0)
    rules = dataclasses.replace(small_design.rules, min_gap_nm=60.0)
    terms = tuple(dataclasses.replace(t, optimise="none") if hasattr(t, "optimise") else t for t in small_design.phase)
    return dataclasses.replace(small_design, device=device, rules=rules, phase=terms)


@pytest.fixture(scope="module")
def profile(design: Design) -> stokes.StokesProfile:
    return stokes.stokes_profile(design, 8.0)


@pytest.fixture(scope="module")
def pillars(profile: stokes.StokesProfile, smooth_library: Library, design: Design) -> stokes.TurnedPillars:
    return stokes.assign(profile, smooth_library, design, angles=ANGLES, size_step_nm=16.0)


@pytest.fixture(scope="module")
def psf(profile: stokes.StokesProfile, design: Design) -> stokes.StokesPsf:
    source = stokes.UnitaryField(profile, lattice_of(design), design.device)
    return stokes.stokes_psf(source, profile, Imaging.of(design), [0.0025, 0.0028, 0.0031, 0.0034], window_px=32)


def test_stokes_vectors_of_the_six_states_are_the_axes_of_the_sphere() -> None:
    expected = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]
    assert stokes.stokes_of(stokes.JONES)[:, 1:] == pytest.approx(np.array(expected, dtype=float), abs=1e-12)


def test_right_handed_light_turns_clockwise_for_who_looks_into_it() -> None:
    """With exp(-i omega t), a quarter of a period later the field has turned from +x to -y (y up, light towards us)."""
    later = (stokes.JONES[stokes.STATES.index("R")] * np.exp(-0.5j * np.pi)).real
    assert later == pytest.approx([0.0, -np.sqrt(0.5)], abs=1e-12)


def complex_numbers() -> st.SearchStrategy[complex]:
    return st.complex_numbers(max_magnitude=3.0, allow_nan=False, allow_infinity=False)


@given(st.lists(complex_numbers(), min_size=6, max_size=6))
def test_the_response_is_the_power_of_any_light_behind_any_jones_matrix(numbers: list[complex]) -> None:
    jones, light = np.array(numbers[:4]).reshape(2, 2), np.array(numbers[4:])
    response = stokes.response_of(jones[0, 0], jones[0, 1], jones[1, 0], jones[1, 1])
    power = float(np.sum(np.abs(jones @ light) ** 2))
    assert response @ stokes.stokes_of(light) == pytest.approx(power, rel=1e-9, abs=1e-9)


@given(st.lists(complex_numbers(), min_size=3, max_size=3))
def test_the_nearest_unitary_is_symmetric_unitary_and_no_turned_pillar_is_nearer(numbers: list[complex]) -> None:
    target = np.array(numbers)
    xx, xy, yy = stokes.nearest_unitary(target)
    unitary = np.array([[xx, xy], [xy, yy]])
    assert unitary @ unitary.conj().T == pytest.approx(np.eye(2), abs=1e-9)
    wanted = np.array([[target[0], target[1]], [target[1], target[2]]])
    phases, angle = np.meshgrid(np.linspace(0, 2 * np.pi, 13), np.linspace(0, np.pi, 13))
    for shift in (0.3, 1.7, 4.0):
        other = turned(np.exp(1j * phases), np.exp(1j * (phases + shift)), angle)
        distance = np.abs(other[0] - target[0]) ** 2 + 2 * np.abs(other[1] - target[1]) ** 2
        distance += np.abs(other[2] - target[2]) ** 2
        assert np.linalg.norm(unitary - wanted) ** 2 <= distance.min() + 1e-9


def test_a_quarter_of_a_turn_exchanges_the_axes() -> None:
    t_x, t_y = np.array(0.8 + 0.1j), np.array(0.2 - 0.7j)
    assert turned(t_x, t_y, np.array(np.pi / 2)) == pytest.approx(np.array([t_y, 0.0, t_x]), abs=1e-12)


def expected_shares() -> tuple[np.ndarray, np.ndarray]:
    """What each place takes of its own and of the orthogonal state if the six phases were independent, by drawing them.

    The coefficient of one of the waves in what perfect pillars send is the mean of their matrices against it.
    """
    waves = np.exp(2j * np.pi * np.random.default_rng(0).random((6, 100_000)))
    states = stokes.JONES.conj()
    entries = np.stack([states[:, 0] ** 2, states[:, 0] * states[:, 1], states[:, 1] ** 2])
    sent = stokes.nearest_unitary(entries @ waves)
    responses = [stokes.response_of(xx, xy, xy, yy) for xx, xy, yy in (sent @ waves.conj().T / waves.shape[1]).T]
    lights = stokes.stokes_of(stokes.JONES)
    return tuple(np.einsum("kj,kj->k", responses, lights[order]) for order in ([0, 1, 2, 3, 4, 5], [1, 0, 3, 2, 5, 4]))


def test_each_place_takes_its_own_state_and_leaves_the_orthogonal_one(
    profile: stokes.StokesProfile, design: Design
) -> None:
    source = stokes.UnitaryField(profile, lattice_of(design), design.device)
    imaging = Imaging.of(design)
    should, should_not = expected_shares()
    # Twice the ninth that three kinds of pillars side by side could send, and nothing of the orthogonal state.
    assert should == pytest.approx(0.27, abs=0.01)
    assert should_not.max() < 1e-4
    window_px = 64
    psf = stokes.stokes_psf(source, profile, imaging, [0.003], window_px=window_px)
    wide = stokes.stokes_psf(source, profile, imaging, [0.003], window_px=2 * window_px)
    lights = stokes.stokes_of(stokes.JONES)
    own = np.einsum("kj,kj->k", wide.instrument, lights)
    other = np.einsum("kj,kj->k", psf.instrument, lights[[1, 0, 3, 2, 5, 4]])
    # A quarter of the aperture spreads its light four times as wide: windows reach to where the next place's begin, and
    # six phases over some thousand pillars are not quite independent.
    assert own.mean() == pytest.approx(should.mean(), rel=0.1)
    # All that goes to no place, spread evenly over the six places' cells alone, would put this much into each window;
    # it goes to further orders, too.
    stray = 1.0 - 0.5 * should.sum()
    places = np.unique(np.round(psf.centre_um), axis=0)
    across, rise = np.ptp(places[:, 0]), np.ptp(places[:, 1]) / 2.0
    most = stray * (window_px * psf.pixel_um) ** 2 / (6.0 * across * rise)
    assert other.mean() < most
    # What leaves cannot be more than what came.
    assert psf.instrument[:, 0].sum() < 1.0


def test_the_pairs_are_conjugate(psf: stokes.StokesPsf) -> None:
    """What the first state of a pair shows at r, the second shows at -r, cross-talk of the sum aside."""
    for first, second in ((0, 1), (2, 3), (4, 5)):
        a, b = (psf.psf[k, 0, 0] / psf.psf[k, 0, 0].sum() for k in (first, second))
        mirrored = np.roll(b[::-1, ::-1], (1, 1), axis=(0, 1))
        alike, unlike = (np.sum(a * c) / np.sqrt(np.sum(a * a) * np.sum(c * c)) for c in (mirrored, b))
        assert alike > 0.8
        assert alike > unlike + 0.1


def test_turned_pillars_keep_the_gap(pillars: stokes.TurnedPillars, design: Design) -> None:
    width, length, angle = pillars.kinds.T
    cosine, sine = np.abs(np.cos(np.radians(angle))), np.abs(np.sin(np.radians(angle)))
    assert (width * cosine + length * sine).max() <= 290.0 + 1e-5
    assert pillars.overlap > 0.6
    used = np.unique(pillars.kinds[pillars.index[pillars.index > 0] - 1, 2])
    assert used.size == ANGLES // 2  # the other half are the same with sides exchanged


@pytest.mark.parametrize("suffix", ["oas", "gds"])
def test_the_file_holds_every_pillar(
    pillars: stokes.TurnedPillars, smooth_library: Library, design: Design, tmp_path: Path, suffix: str
) -> None:
    path = mask.write(pillars, tmp_path / f"turned.{suffix}", design)
    back = mask.read(path, smooth_library, design, angles=ANGLES)

    def matrices(of: stokes.TurnedPillars) -> ComplexArray:
        return of.jones[of.index]

    assert matrices(back) == pytest.approx(matrices(pillars), abs=1e-12)
    assert mask.write(pillars, tmp_path / f"again.{suffix}", design).read_bytes() == path.read_bytes()


def test_files_of_other_things_are_refused(smooth_library: Library, design: Design, tmp_path: Path) -> None:
    (tmp_path / "broken.oas").write_bytes(b"nothing")
    with pytest.raises(InputError, match="one top cell"):
        mask.read(tmp_path / "broken.oas", smooth_library, design, angles=ANGLES)


def test_a_gap_without_room_is_refused(profile: stokes.StokesProfile, smooth_library: Library, design: Design) -> None:
    tight = dataclasses.replace(design, rules=dataclasses.replace(design.rules, min_gap_nm=260.0))
    with pytest.raises(InputError, match="turned pillars"):
        stokes.assign(profile, smooth_library, tight)


def decoded(psf: stokes.StokesPsf, state: tuple[float, float, float]) -> tuple[stokes.StokesFrame, StokesImage]:
    piece = SceneObject(depth_m=0.0029, size=(0.14, 0.14), stokes=state)
    frame = stokes.photograph(Scene(objects=(piece,), field_px=(112, 112), photons_per_pixel=20000.0), psf)
    return frame, stokes.decode_stokes(frame, psf)


@pytest.mark.parametrize("state", [(0.0, 0.0, 0.0), (0.6, -0.3, 0.0), (0.0, 0.2, -0.8)])
def test_polarisation_and_depth_of_a_surface_are_found(
    psf: stokes.StokesPsf, state: tuple[float, float, float]
) -> None:
    frame, image = decoded(psf, state)
    middle = (slice(None), *(slice(n // 2 - 16, n // 2 + 16) for n in frame.depth_m.shape))
    total = image.stokes[middle].sum(axis=(1, 2))
    # 1024 pixels of some 20000 electrons in each of six images: noise is below a thousandth.
    assert total[1:] / total[0] == pytest.approx(state, abs=0.005)
    assert total[0] == pytest.approx(frame.stokes[middle].sum(axis=(1, 2))[0], rel=0.02)
    depth_m = np.nanmedian(image.depth_m[middle[1:]])
    # A quarter of the aperture turns its lobe by a sixteenth of the angle.
    assert depth_m == pytest.approx(0.0029, rel=0.03)


@pytest.fixture(scope="module")
def whole_psf(small_design: Design) -> stokes.StokesPsf:
    """Of perfect pillars on the small lens' whole aperture."""
    terms = tuple(dataclasses.replace(t, optimise="none") if hasattr(t, "optimise") else t for t in small_design.phase)
    whole = dataclasses.replace(small_design, phase=terms)
    profile = stokes.stokes_profile(whole, 8.0)
    source = stokes.UnitaryField(profile, lattice_of(whole), whole.device)
    return stokes.stokes_psf(source, profile, Imaging.of(whole), [0.0025, 0.0027, 0.0029, 0.0031, 0.0034], window_px=48)


def test_objects_side_by_side_keep_their_depths_and_outlines(whole_psf: stokes.StokesPsf) -> None:
    """No ramp of depths between two objects that touch, nothing around them, and each at its own depth."""
    near, far = (
        SceneObject(depth_m=z, centre=(x, 0.0), size=(0.12, 0.16), stokes=(0.3, s, 0.0))
        for z, x, s in ((0.00265, -0.06, 0.5), (0.0032, 0.06, -0.5))
    )
    scene = Scene(objects=(near, far), field_px=(112, 144), photons_per_pixel=20000.0)
    frame = stokes.photograph(scene, whole_psf)
    image = stokes.decode_stokes(frame, whole_psf)
    found = np.unique(image.depth_m[np.isfinite(image.depth_m)])
    assert found.size == 2
    assert found == pytest.approx([0.00265, 0.0032], rel=0.01)
    known, true = np.isfinite(image.depth_m), np.isfinite(frame.depth_m)
    # Along outlines of 72 by 100 pixels each, a pixel is some 5 %.
    assert (known & ~true).sum() < 0.05 * true.sum()
    assert (known & true).sum() > 0.98 * true.sum()
    # Half a window on either side of the edge that they share is a quarter of each: most of it is told apart, too.
    assert np.mean(np.abs(image.depth_m[known & true] / frame.depth_m[known & true] - 1.0) > 0.1) < 0.14
    errors = stokes.stokes_errors(image, frame)
    # Where no neighbour's blur reaches, cross-talk is undone; along outlines it is that of the wrong depth.
    assert errors["stokes_interior_error"] < 0.01
    assert errors["stokes_object_error"] < 0.03


def test_the_field_stop_passes_its_pixels_and_the_margin_their_blur(whole_psf: stokes.StokesPsf) -> None:
    """A surface beyond the field is cut at the stop, not at the frame: what it sends into the field is all there."""
    piece = SceneObject(depth_m=0.0029, size=(1.0, 1.0), texture="uniform")
    scene = Scene(objects=(piece,), field_px=(64, 80), photons_per_pixel=50000.0, read_noise_e=0.0)
    frame = stokes.photograph(scene, whole_psf)
    assert frame.images.shape == (6, 64 + 48, 80 + 48)
    assert np.isfinite(frame.depth_m).sum() == 64 * 80
    # All light of the field lands in the frame: the mean image of unpolarised light has gain 1.
    total = frame.images.sum() / 6.0
    assert total == pytest.approx(frame.stokes[0].sum(), rel=0.01)


def test_the_sensor_is_that_of_the_camera(whole_psf: stokes.StokesPsf) -> None:
    piece = SceneObject(depth_m=0.0029, size=(0.05, 0.05), texture="uniform")
    plain = Scene(objects=(piece,), field_px=(96, 96), photons_per_pixel=2000.0)
    full = dataclasses.replace(plain, full_well_e=1500.0, bit_depth=8, hot_pixels=0.01)
    images = stokes.photograph(full, whole_psf).images
    assert images.max() == 1500.0
    assert np.unique(images).size <= 256
    corner = images[:, :12, :12]
    assert 0 < (corner == 1500.0).sum() < 0.05 * corner.size
    lit = dataclasses.replace(plain, background=0.5)
    added = stokes.photograph(lit, whole_psf).images - stokes.photograph(plain, whole_psf).images
    middle, beside, beyond = (added[:, rows, 66:78].mean() for rows in (slice(69, 75), slice(26, 36), slice(4, 20)))
    # The piece of 31 pixels hides what is behind it, but for the halo of its blur; the stop cuts the background, too.
    assert middle < 300.0
    assert beside == pytest.approx(1000.0, rel=0.1)
    assert beyond == pytest.approx(0.0, abs=1.0)


def test_motion_is_refused(small_design: Design, tmp_path: Path) -> None:
    assert small_design.scene is not None
    moving = dataclasses.replace(small_design.scene.objects[0], velocity_m_per_s=(0.1, 0.0, 0.0))
    scene = dataclasses.replace(small_design.scene, objects=(moving,), exposure_s=0.01)
    job = Job(dataclasses.replace(small_design, scene=scene), tmp_path)
    with pytest.raises(InputError, match="exposure_s"):
        full_stokes(job, row_angle_deg=8.0, angles=8, size_step_nm=20.0)


def test_without_light_no_depth_is_claimed(psf: stokes.StokesPsf) -> None:
    dark = SceneObject(depth_m=0.0029, size=(1e-6, 1e-6))
    frame = stokes.photograph(Scene(objects=(dark,), field_px=(64, 64)), psf)
    image = stokes.decode_stokes(frame, psf)
    assert np.isnan(image.depth_m).mean() > 0.9


def test_more_than_full_polarisation_is_refused() -> None:
    with pytest.raises(ValidationError, match="longer than 1"):
        SceneObject(depth_m=1.0, stokes=(0.8, 0.8, 0.0))
