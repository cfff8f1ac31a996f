"""A camera is calibrated from photographs of a point: planted misalignments come back.

The photographs are made by a direct transform of the pupil at each pixel of the misaligned sensor: nothing of the
calibration's resampling or interpolation is in them.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from metafab import camera, optics
from metafab.camera import RawFrame, capture
from metafab.core.errors import InputError
from metafab.decode import calibrate, decode, read_depths
from metafab.optics.point_spread import Psf
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import FOCUS_DEPTH_M, PIXEL_UM, RADIUS_UM, WAVELENGTH_UM, helix_psf
from tests.main_job import metafab

DEPTHS_M = 1.0 / np.linspace(1 / 0.0024, 1 / 0.0036, 13)
POINTS_M = (0.0027, 0.0029, 0.0032)
ZONES = 4


@pytest.fixture(scope="module")
def predicted() -> Psf:
    return helix_psf(DEPTHS_M)


def photograph(
    predicted: Psf,
    depth_m: float,
    offsets_per_m: tuple[float, float],
    rotation_deg: float = 0.0,
    magnification: float = 1.0,
    shift_um: tuple[float, float] = (0.0, 0.0),
    electrons: float = 2e5,
    seed: int = 0,
) -> RawFrame:
    """A point on the axis, seen by a sensor that is turned, magnified and shifted, in photon noise."""
    shape, origin = (150, 330), (-395.0, -178.0)
    frame = np.zeros(shape)
    turn = magnification * np.exp(1j * math.radians(rotation_deg))
    count = 57
    u = np.linspace(-1.0, 1.0, count)
    px, py = np.meshgrid(u, u)
    radius = np.hypot(px, py)
    for polarisation in (0, 1):
        centre = predicted.centre_um[polarisation, DEPTHS_M.size // 2]
        place = turn * (centre[0] + 1j * centre[1]) + complex(*shift_um)
        column, row = round((place.real - origin[0]) / PIXEL_UM), round((place.imag - origin[1]) / PIXEL_UM)
        rows, columns = np.arange(row - 24, row + 24), np.arange(column - 24, column + 24)
        x, y = origin[0] + PIXEL_UM * columns - place.real, origin[1] + PIXEL_UM * rows - place.imag
        azimuth = np.arctan2(-py, -px) if polarisation else np.arctan2(py, px)
        vergence = 1.0 / depth_m + offsets_per_m[polarisation] - 1.0 / FOCUS_DEPTH_M
        defocus = math.pi / WAVELENGTH_UM * (RADIUS_UM * radius) ** 2 * vergence * 1e-6
        phase = np.ceil(ZONES * np.clip(radius, 1e-9, 1.0) ** 2) * azimuth + defocus
        inside = radius <= 1.0
        k = 2.0 * math.pi * RADIUS_UM / (WAVELENGTH_UM * predicted.sensor_distance_um)
        # The pupil as the turned and magnified sensor sees it.
        seen = (px[inside] + 1j * py[inside]) / turn.conjugate()
        along_x, along_y = (np.exp(-1j * k * np.outer(at, part)) for at, part in ((x, seen.real), (y, seen.imag)))
        spot = np.abs((along_y * np.exp(1j * phase[inside])) @ along_x.T) ** 2
        frame[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] += electrons * spot / spot.sum()
    noisy = np.random.default_rng(seed).poisson(frame).astype(float)
    return RawFrame(noisy, PIXEL_UM, origin, 0.0)


def photographs(predicted: Psf, **camera: object) -> list[RawFrame]:
    return [photograph(predicted, z, seed=i, **camera) for i, z in enumerate(POINTS_M)]  # type: ignore[arg-type]


def test_an_aligned_camera_is_found_aligned(predicted: Psf) -> None:
    calibrated, fit = calibrate(photographs(predicted, offsets_per_m=(0.0, 0.0)), POINTS_M, predicted)
    # The range spans 139 per metre; 2e5 electrons leave far less than the pixel's own blur (0.1 % of kernels).
    assert abs(fit.vergence_offset_per_m) < 0.7
    assert abs(fit.rotation_deg) < 0.02
    assert fit.magnification == pytest.approx(1.0, abs=3e-4)
    assert calibrated.depth_m.size >= DEPTHS_M.size - 2


def test_planted_misalignments_come_back(predicted: Psf) -> None:
    offset, tilt, rotation, magnification, shift = 6.0, 1.5, 0.8, 1.004, (7.3, -4.1)
    frames = photographs(
        predicted,
        offsets_per_m=(offset - tilt, offset + tilt),
        rotation_deg=rotation,
        magnification=magnification,
        shift_um=shift,
    )
    calibrated, fit = calibrate(frames, POINTS_M, predicted)
    # 0.7 per metre is 0.2 % of the depth: half of what the paper's decoder errs by.
    assert fit.vergence_offset_per_m == pytest.approx(offset, abs=0.7)
    assert fit.tilt_per_m == pytest.approx(tilt, abs=0.7)
    # A twentieth of a pixel over the 174 pixels between the images.
    assert fit.rotation_deg == pytest.approx(rotation, abs=0.02)
    assert fit.magnification == pytest.approx(magnification, abs=3e-4)
    assert fit.shift_um == pytest.approx(shift, abs=0.05 * PIXEL_UM)
    assert fit.place_rms_px < 0.05
    want = np.array(fit.turn @ predicted.centre_um[0, 0]) + np.array(fit.shift_um)
    np.testing.assert_allclose(calibrated.centre_um[0, 0], want)


def spot_of_a_split_lens(stretch: float, distance_um: float, depth_um: float, place_um: np.ndarray) -> np.ndarray:
    """Intensity behind a fixed mask, a direct sum over its pupil along x, at a wavelength ``stretch`` times its own."""
    x = np.linspace(-100.0, 100.0, 2001)
    k_own = 2.0 * np.pi / WAVELENGTH_UM
    focus_um, angle = 1000.0, math.radians(8.0)
    mask = -k_own * np.hypot(x - focus_um * math.sin(angle), focus_um * math.cos(angle))
    k = k_own / stretch
    path = np.hypot(x, depth_um) + np.hypot(place_um[:, None] - x, distance_um)
    return np.abs(np.exp(1j * (mask + k * path)).sum(axis=1)) ** 2


def test_a_longer_wavelength_is_a_nearer_object_and_sensor() -> None:
    """Why both are not told apart: of the split's dispersion, a part of tan^2(8 degrees) = 2 % is left."""
    share, depth_um = 0.05, 3000.0
    distance_um = math.cos(math.radians(8.0)) / (1.0 / 1000.0 - 1.0 / depth_um)
    place_um = distance_um * math.tan(math.radians(8.0)) + np.arange(-60.0, 60.0, 0.25)
    own = spot_of_a_split_lens(1.0, distance_um, depth_um, place_um)
    longer = spot_of_a_split_lens(1.0 + share, distance_um, depth_um, place_um)
    both = spot_of_a_split_lens(1.0 + share, distance_um / (1.0 + share), depth_um / (1.0 + share), place_um)
    at = [float(place_um[spot.argmax()]) for spot in (own, longer, both)]
    steeper = math.tan(math.asin((1.0 + share) * math.sin(math.radians(8.0))))
    moved_um = distance_um * (steeper - math.tan(math.radians(8.0)))
    assert at[1] - at[0] == pytest.approx(moved_um, rel=0.05)
    assert abs(at[2] - at[0]) < 0.05 * moved_um
    # The longer wavelength alone is out of focus; the three together are the same spot.
    assert both.max() == pytest.approx(own.max(), rel=0.02)
    assert longer.max() < 0.9 * own.max()


def test_misalignments_come_back_within_their_stated_errors(predicted: Psf) -> None:
    """Three cameras, each of its own misalignments and noise, five figures each.

    Of fifteen, by chance none is beyond four standard errors. What a point photographed at pixel centres differs from
    pixels' means is a bias of 0.4 per metre, common to all.
    """
    rng = np.random.default_rng(4)
    ratios = []
    for _ in range(3):
        offset, tilt, rotation = rng.uniform(-5.0, 5.0), rng.uniform(-1.5, 1.5), rng.uniform(-1.0, 1.0)
        magnification, shift = rng.uniform(0.995, 1.005), tuple(rng.uniform(-8.0, 8.0, 2).tolist())
        frames = [
            photograph(predicted, z, (offset - tilt, offset + tilt), rotation, magnification, shift, 2e4, seed)
            for z, seed in zip(POINTS_M, rng.integers(0, 1000, 3).tolist(), strict=True)
        ]
        _, fit = calibrate(frames, POINTS_M, predicted)
        ratios.append(
            [
                (fit.vergence_offset_per_m - offset) / math.hypot(fit.vergence_error_per_m, 0.4),
                (fit.tilt_per_m - tilt) / fit.vergence_error_per_m,
                (fit.rotation_deg - rotation) / fit.rotation_error_deg,
                (fit.magnification - magnification) / fit.magnification_error,
                (fit.shift_um[0] - shift[0]) / fit.shift_error_um,
            ]
        )
        assert 0.0 < fit.vergence_error_per_m < 1.0
    away = np.abs(ratios)
    assert away.max() < 4.0
    # Nor are they overstated: the rms of twelve is known to 20 %.
    assert np.sqrt(np.mean(away[:, 1:] ** 2)) > 0.3


def test_a_calibrated_camera_decodes_what_the_prediction_misreads(predicted: Psf) -> None:
    """The camera's own pictures carry its offset: 8 per metre are 2.3 % of the depth."""
    offset = 8.0
    frames = photographs(predicted, offsets_per_m=(offset, offset))
    calibrated, _ = calibrate(frames, POINTS_M, predicted)
    moved = 1.0 / (1.0 / DEPTHS_M + offset)
    camera = dataclasses.replace(helix_psf(moved), depth_m=DEPTHS_M)
    scene = Scene(objects=(SceneObject(depth_m=0.0029, size=(0.15, 0.15)),), seed=3)
    frame = capture(scene, camera)
    wrong, right = decode(frame, predicted), decode(frame, calibrated)
    assert right.nmae is not None
    assert wrong.nmae is not None
    assert right.nmae < 0.006
    assert wrong.nmae > 0.015


def test_what_cannot_be_a_calibration_is_refused(predicted: Psf) -> None:
    good = photograph(predicted, 0.003, (0.0, 0.0))
    dark = dataclasses.replace(good, frame=np.zeros_like(good.frame))
    with pytest.raises(InputError, match="two depths"):
        calibrate([good], [0.003], predicted)
    with pytest.raises(InputError, match="covers"):
        calibrate([good, good], [0.003, 0.3], predicted)
    with pytest.raises(InputError, match="image of a point"):
        calibrate([good, dark], [0.003, 0.0029], predicted)
    with pytest.raises(InputError, match="pixel"):
        calibrate([good, dataclasses.replace(good, pixel_um=3.0)], [0.003, 0.0029], predicted)


def flipped(frame: RawFrame) -> RawFrame:
    """The last row first: a file that was read the wrong way up."""
    last_um = frame.origin_um[1] + (frame.frame.shape[0] - 1) * frame.pixel_um
    return dataclasses.replace(frame, frame=frame.frame[::-1], origin_um=(frame.origin_um[0], -last_um))


def pictures_of_a_scene(predicted: Psf) -> list[RawFrame]:
    """Textured squares at the depths of the table: three good photographs, of no point."""
    return [
        capture(Scene(objects=(SceneObject(depth_m=z, size=(0.12, 0.12)),), field_px=(96, 96), seed=n), predicted)
        for n, z in enumerate(POINTS_M)
    ]


def test_a_scene_makes_no_camera(predicted: Psf) -> None:
    with pytest.raises(InputError, match="is it a point"):
        calibrate(pictures_of_a_scene(predicted), POINTS_M, predicted)


def test_depths_in_the_wrong_order_make_no_camera(predicted: Psf) -> None:
    frames = photographs(predicted, offsets_per_m=(4.0, 4.0))
    with pytest.raises(InputError, match="table of depths") as refused:
        calibrate(frames, POINTS_M[::-1], predicted)
    assert [fault.field for fault in refused.value.faults] == ["vergence_rms_per_m"]
    with pytest.raises(InputError, match="table of depths"):
        calibrate(frames[:2], POINTS_M[1::-1], predicted)


@pytest.mark.parametrize("electrons", [2e4, 2e6])
def test_frames_upside_down_make_no_camera(predicted: Psf, electrons: float) -> None:
    frames = photographs(predicted, offsets_per_m=(4.0, 4.0), electrons=electrons)
    with pytest.raises(InputError, match="the right way up"):
        calibrate([flipped(frame) for frame in frames], POINTS_M, predicted)


def test_a_point_beyond_the_predicted_range_makes_no_camera(predicted: Psf) -> None:
    with pytest.raises(InputError, match="wider range"):
        calibrate(photographs(predicted, offsets_per_m=(52.0, 52.0)), POINTS_M, predicted)


def test_a_point_that_moved_makes_no_camera(predicted: Psf) -> None:
    frames = photographs(predicted, offsets_per_m=(0.0, 0.0))
    x_um, y_um = frames[1].origin_um
    frames[1] = dataclasses.replace(frames[1], origin_um=(x_um + 4.0 * PIXEL_UM, y_um))
    with pytest.raises(InputError, match="place_rms_px"):
        calibrate(frames, POINTS_M, predicted)


def test_saturated_points_are_told_and_hot_pixels_are_none(predicted: Psf) -> None:
    frames = photographs(predicted, offsets_per_m=(3.0, 3.0))
    full_e = 0.6 * max(float(frame.frame.max()) for frame in frames)
    cut = [dataclasses.replace(frame, frame=np.minimum(frame.frame, full_e), saturation_e=full_e) for frame in frames]
    with pytest.raises(InputError, match="full pixels") as refused:
        calibrate(cut, POINTS_M, predicted)
    assert [fault.field for fault in refused.value.faults] == [f"frame at {z} m" for z in (0.0027, 0.0029, 0.0032)]
    hot_e = 2.0 * full_e
    rng = np.random.default_rng(1)
    hot = [
        dataclasses.replace(
            frame, frame=np.where(rng.random(frame.frame.shape) < 5e-4, hot_e, frame.frame), saturation_e=hot_e
        )
        for frame in frames
    ]
    _, fit = calibrate(hot, POINTS_M, predicted)
    assert fit.vergence_offset_per_m == pytest.approx(3.0, abs=1.0)


def test_what_the_fit_leaves_is_stated(predicted: Psf) -> None:
    """Photon noise alone leaves a chi-square of one; what a prediction gets wrong grows with the light."""
    faint, bright = (
        calibrate(photographs(predicted, offsets_per_m=(0.0, 0.0), electrons=e), POINTS_M, predicted)[1]
        for e in (2e4, 2e6)
    )
    assert 0.5 < faint.chi_square < 1.5
    assert bright.chi_square > 2.0 * faint.chi_square
    # The pixel's own blur, which the photographs have not: the same share of the power at any light.
    assert faint.misfit < 0.06
    assert 0.001 < bright.misfit < 0.06


def test_the_command_refuses_what_is_no_calibration(predicted: Psf, tmp_path: Path) -> None:
    optics.save(predicted, tmp_path / "psf.h5")
    names = [tmp_path / f"scene{i}.tif" for i in range(3)]
    for name, frame in zip(names, pictures_of_a_scene(predicted), strict=True):
        camera.save_counts(frame, name)
    table = "".join(f"{name.name}, {z}\n" for name, z in zip(names, POINTS_M, strict=True))
    (tmp_path / "depths.csv").write_text(table)
    answer = metafab(
        "calibrate", *names, "--psf", tmp_path / "psf.h5", "--depths", tmp_path / "depths.csv",
        "-o", tmp_path / "cal.h5", "--json",
    )  # fmt: skip
    assert (answer.code, answer.stdout) == (2, "")
    assert "is it a point" in answer.stderr
    assert not (tmp_path / "cal.h5").exists()


def test_the_command_writes_a_calibration_that_decodes(predicted: Psf, tmp_path: Path) -> None:
    frames = photographs(predicted, offsets_per_m=(5.0, 5.0))
    optics.save(predicted, tmp_path / "psf.h5")
    names = [tmp_path / f"point{i}.h5" for i in range(len(frames))]
    for name, frame in zip(names, frames, strict=True):
        camera.save(frame, name)
    table = "".join(f"{name.name}, {z}\n" for name, z in zip(names, POINTS_M, strict=True))
    (tmp_path / "depths.csv").write_text("# frame, depth / m\n" + table)
    answer = metafab(
        "calibrate", *names, "--psf", tmp_path / "psf.h5", "--depths", tmp_path / "depths.csv",
        "-o", tmp_path / "cal.h5", "--json",
    )  # fmt: skip
    assert answer.code == 0, answer.stderr
    assert answer.json["vergence_offset_per_m"] == pytest.approx(5.0, abs=0.7)
    stored = optics.load(tmp_path / "cal.h5").details.camera_fit
    assert stored["vergence_offset_per_m"] == answer.json["vergence_offset_per_m"]


def test_a_table_of_depths_names_all_its_faults(tmp_path: Path) -> None:
    (tmp_path / "depths.csv").write_text("a.tif, 0.3\nb.tif, far\n\nc.tif, -1\na.tif, 0.4\n")
    with pytest.raises(InputError) as refused:
        read_depths(tmp_path / "depths.csv", [Path("a.tif"), Path("d.tif")])
    assert [fault.field for fault in refused.value.faults] == ["line 2", "line 4", "line 5", "d.tif"]
    (tmp_path / "marked.csv").write_text("a.tif, 0.3\n", encoding="utf-8-sig")  # as spreadsheets write it
    assert read_depths(tmp_path / "marked.csv", [Path("a.tif")]) == [0.3]
    with pytest.raises(InputError, match="readable"):
        read_depths(tmp_path / "none.csv", [])


def test_frames_of_one_name_are_told_apart_by_their_paths(tmp_path: Path) -> None:
    frames = [Path("near/p.tif"), Path("far/p.tif"), Path("far/q.tif")]
    (tmp_path / "names.csv").write_text("p.tif, 0.3\nq.tif, 0.5\n")
    with pytest.raises(InputError) as refused:
        read_depths(tmp_path / "names.csv", frames)
    assert [fault.field for fault in refused.value.faults] == ["near/p.tif", "far/p.tif"]
    (tmp_path / "paths.csv").write_text("near/p.tif, 0.3\nfar/p.tif, 0.4\nfar/q.tif, 0.5\n")
    assert read_depths(tmp_path / "paths.csv", frames) == [0.3, 0.4, 0.5]
    (tmp_path / "dotted.csv").write_text("./near/p.tif, 0.3\nfar//p.tif, 0.4\nq.tif, 0.5\n")
    assert read_depths(tmp_path / "dotted.csv", frames) == [0.3, 0.4, 0.5]


@pytest.mark.parametrize("text", ["p.tif; 0.0026", "p.tif, 0,0026", "q.tif, 0.0026"])
def test_a_table_of_other_lines_says_how_they_are_written(text: str, tmp_path: Path) -> None:
    (tmp_path / "depths.csv").write_text(text)
    with pytest.raises(InputError, match="write one line `frame, depth in m` for each photograph, with a comma and"):
        read_depths(tmp_path / "depths.csv", [Path("p.tif")])
    with pytest.raises(InputError, match=r"got none .No such file or directory.; write one line"):
        read_depths(tmp_path / "none.csv", [Path("p.tif")])
