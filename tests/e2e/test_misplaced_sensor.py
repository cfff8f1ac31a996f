"""A sensor that stands too near: the exact camera behind the written mask, calibrated by photographs of a point."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab import camera, decode, optics
from metafab.optics import Psf
from metafab.spec import Scene, load_design, load_scene
from metafab.steps.job import Job
from metafab.steps.optics import WrittenLens, calibration, calibration_depths, mask_source
from tests.conftest import MainJob
from tests.main_job import ROOT, SMALL

POINT = ROOT / "layouts" / "scenes" / "point.toml"
DEPTHS_M = (0.0026, 0.0029, 0.0032)
#: Where the displaced sensor is sharp; the design says 3.0 mm.
FOCUS_M = 0.0031


@pytest.fixture(scope="module")
def predicted(main_job: MainJob) -> Psf:
    return optics.load(main_job.folder / "psf.h5")


@pytest.fixture(scope="module")
def displaced(main_job: MainJob, tmp_path_factory: pytest.TempPathFactory) -> Psf:
    """The pair of the same written mask on a sensor elsewhere."""
    design = load_design(SMALL)
    moved = replace(design, sensor=replace(design.sensor, focus_depth_m=FOCUS_M))
    return calibration(Job(moved, tmp_path_factory.mktemp("displaced")), WrittenLens(main_job.folder / "layout.oas"))


def calibrated(predicted: Psf, camera_pair: Psf, folder: Path) -> tuple[Psf, decode.CameraFit]:
    """From 16-bit pictures of a point, as a camera writes them."""
    point = load_scene(POINT)
    frames = []
    for number, depth_m in enumerate(DEPTHS_M):
        scene = replace(point, objects=(replace(point.objects[0], depth_m=depth_m),), seed=number)
        camera.save_counts(camera.capture(scene, camera_pair), folder / f"{number}.tif")
        counts = camera.Counts(read_noise_e=scene.read_noise_e)
        frames.append(camera.load_frame(folder / f"{number}.tif", predicted, counts=counts))
    return decode.calibrate(frames, DEPTHS_M, predicted)


@pytest.fixture(scope="module")
def fitted(predicted: Psf, displaced: Psf, tmp_path_factory: pytest.TempPathFactory) -> tuple[Psf, decode.CameraFit]:
    """The prediction as three photographs of a point correct it."""
    return calibrated(predicted, displaced, tmp_path_factory.mktemp("points"))


def test_the_displacement_comes_back(predicted: Psf, displaced: Psf, fitted: tuple[Psf, decode.CameraFit]) -> None:
    _, fit = fitted
    # Slantwise light at 8 degrees: cos^2 of it in the plane of incidence.
    along_y = 1.0 / 0.003 - 1.0 / FOCUS_M
    wanted = 0.5 * along_y * (1.0 + np.cos(np.radians(8.0)) ** 2)
    assert fit.vergence_offset_per_m == pytest.approx(wanted, abs=3.0 * fit.vergence_error_per_m)
    # A pinhole as wide as a pixel is no point: what it costs and the noise are less than 0.3 % of the depth.
    assert abs(fit.vergence_offset_per_m - wanted) < 0.003 / 0.0029
    ratio = displaced.sensor_distance_um / predicted.sensor_distance_um
    assert fit.magnification == pytest.approx(ratio, abs=3.0 * fit.magnification_error)
    assert abs(fit.rotation_deg) < 3.0 * fit.rotation_error_deg
    assert np.hypot(*fit.shift_um) < 4.0 * fit.shift_error_um
    assert abs(fit.tilt_per_m) < 3.0 * fit.vergence_error_per_m


def test_its_frames_are_read_as_by_its_own_pair(
    predicted: Psf, displaced: Psf, fitted: tuple[Psf, decode.CameraFit]
) -> None:
    scene = load_design(SMALL).scene
    assert isinstance(scene, Scene)
    frame = camera.capture(scene, displaced)
    uncalibrated, calibrated, own = (decode.decode(frame, psf) for psf in (predicted, fitted[0], displaced))
    assert uncalibrated.figures.object_error > 0.03
    assert "calibration" in str(uncalibrated.figures.warning)
    assert calibrated.figures.warning is None
    assert own.figures.warning is None
    assert calibrated.figures.object_error < 0.005
    assert calibrated.nmae is not None
    assert own.nmae is not None
    assert calibrated.nmae < own.nmae + 0.003


def test_another_wavelength_is_calibrated_as_the_sensor_that_it_looks_like(
    predicted: Psf, main_job: MainJob, tmp_path: Path
) -> None:
    """4 nm more behind the same pillars: spots further apart and larger by 0.5 %, as on a farther sensor.

    Light and mask add up to (1/z + 1/s') / (1 + d) - 1/f: seen from the prediction, 1/z has changed by -d (1/z + 1/s').
    """
    design = load_design(SMALL)
    assert design.scene is not None
    job, share = Job(design, tmp_path), 0.005
    imaging = optics.Imaging.of(design)
    redder = optics.psf(
        mask_source(job, main_job.folder / "layout.oas"),
        replace(imaging, wavelength_um=(1.0 + share) * imaging.wavelength_um),
        calibration_depths(design, imaging),
        optics.PsfNumerics(window_px=design.verify.window_px),
        field_tangents=optics.field_tangents(design, imaging),
    )
    # The grating law at the longer wavelength, where the window's centre keeps to the design's.
    corrected, fit = calibrated(predicted, redder, tmp_path)
    slant_um = imaging.sensor_distance_um / np.cos(np.radians(8.0))
    wanted = -share * (1.0 / 0.0029 + 1e6 / slant_um)
    assert fit.vergence_offset_per_m == pytest.approx(wanted, abs=0.003 / 0.0029)
    steeper = np.tan(np.arcsin((1.0 + share) * np.sin(np.radians(8.0)))) / np.tan(np.radians(8.0))
    assert fit.magnification == pytest.approx(steeper, abs=5.0 * fit.magnification_error)
    frame = camera.capture(design.scene, redder)
    assert decode.decode(frame, corrected).figures.object_error < 0.005
    assert decode.decode(frame, predicted).figures.object_error > 0.01
