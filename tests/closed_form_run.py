"""A run whose every result is in closed form: a PSF pair that turns by a known angle, a scene of known depths."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from metafab.camera.frames.frame import RawFrame, Truth
from metafab.core.figures import PhaseFigures, SegmentFigures
from metafab.decode.image import Image4D
from metafab.layout.pillars import Lattice, PillarMap
from metafab.library.library import Library
from metafab.optics.point_spread import Psf, PsfField
from metafab.report.run_folder import AperturePhases, DesignOutline, RunFolder
from metafab.steps.images import DecodeFigures
from metafab.steps.layout import DrcFigures, FileFigures, LayoutFigures
from metafab.steps.library import LibraryFigures
from metafab.steps.optics import PsfFigures
from metafab.steps.summary import RunSummary, SkippedStep, error_budget

DEPTHS_M = np.linspace(0.25, 0.35, 9)
SHAPE = (48, 64)


def turning_psf(share: float = 1.0) -> Psf:
    """A Gaussian lobe 8 um from the image point that turns by 20 degrees a step; y's is the point mirror image."""
    pixel_um, n = 1.0, 33
    phi_deg = 40.0 + 20.0 * np.arange(DEPTHS_M.size)
    axis = (np.arange(n) - n // 2) * pixel_um
    x, y = axis[None, :], axis[:, None]
    lobes = []
    for sign in (1.0, -1.0):
        u, v = (sign * 8.0 * f(np.radians(phi_deg))[:, None, None] for f in (np.cos, np.sin))
        lobes.append(np.exp(-((x - u) ** 2 + (y - v) ** 2) / 8.0) / (8.0 * np.pi))
    centre = np.zeros((2, DEPTHS_M.size, 2))
    wrapped = np.mod(phi_deg + 180.0, 360.0) - 180.0
    efficiency = np.full((2, DEPTHS_M.size), share)
    field = PsfField(
        np.array([-0.1, 0.0, 0.1]),
        np.array([-0.05, 0.05]),
        np.broadcast_to(share * np.stack(lobes)[:, :, None, None], (2, 9, 2, 3, n, n)).astype(np.float32),
        np.zeros((2, 9, 2, 3, 2)),
    )
    return Psf(
        DEPTHS_M,
        pixel_um,
        share * np.stack(lobes),
        centre,
        wrapped,
        np.full(9, 1e-3),
        efficiency,
        np.full(9, 30.0),
        2e4,
        field,
    )


def decoded_image() -> Image4D:
    """Two segments at 0.26 m and 0.33 m on an empty ground."""
    segment = np.zeros(SHAPE, dtype=np.int32)
    segment[8:24, 10:30], segment[28:40, 34:58] = 1, 2
    depth = np.choose(segment, [np.nan, 0.2604, 0.3291])
    intensity_x = np.choose(segment, [0.0, 900.0, 1500.0])
    intensity_y = np.choose(segment, [0.0, 850.0, 600.0])
    with np.errstate(invalid="ignore", divide="ignore"):
        contrast = np.where(segment > 0, intensity_x / intensity_y, np.nan)
    rows = (
        SegmentFigures(1, 320, 0.2604, 0.0, 0.0, 4e-4, 900.0 / 850.0, 2e-3, 0.98),
        SegmentFigures(2, 288, 0.3291, 0.0, 0.0, 8e-4, 2.5, 5e-3, 0.97),
    )
    confidence = np.where(segment > 0, 0.9, 0.0)
    return Image4D(
        intensity_x, intensity_y, contrast, depth, confidence, segment, (-3000.0, -80.0), 3.45, rows, nmae=2.1e-3
    )


def raw_frame() -> RawFrame:
    """Both images side by side."""
    image = decoded_image()
    truth = Truth(np.choose(image.segment, [np.nan, 0.26, 0.33]), image.intensity_x, image.intensity_y, image.segment)
    frame = np.hstack([image.intensity_x, np.zeros((SHAPE[0], 20)), image.intensity_y])
    return RawFrame(frame, 3.45, (-3000.0, -80.0), 2.0, truth, (-3000.0, -80.0))


def pillar_map() -> PillarMap:
    """A disc of two sizes, in tiles that do not divide the lattice."""
    lattice = Lattice(period_dbu=(700, 700), shape=(101, 101), database_unit_nm=0.5)
    y, x = np.mgrid[-50:51, -50:51]
    index = np.where(x**2 + y**2 <= 48**2, 1 + (x + y) % 2, 0).astype(np.uint16)
    sizes = np.array([[0, 0], [200, 400], [500, 300]], dtype=np.int32)
    return PillarMap.from_array(lattice, sizes, index, 40)


def run_summary() -> RunSummary:
    """Summary of the run, with one broken rule and one error that was not measured."""
    psf, ideal = turning_psf(0.6), turning_psf(0.9)
    layout = LayoutFigures(
        pillars=7213,
        distinct_sizes=2,
        min_gap_nm=100.0,
        phase_rms_error_rad=0.08,
        mean_transmittance=0.9,
        mean_transmittance_x=0.9,
        mean_transmittance_y=0.9,
        field_overlap=0.99,
        field_overlap_x=0.99,
        field_overlap_y=0.99,
        efficiency=0.89,
        efficiency_x=0.89,
        efficiency_y=0.89,
        offsets_rad=(0.0, 0.0),
        files=(FileFigures("layout.gds", 461632), FileFigures("layout.oas", 9001)),
    )
    library = LibraryFigures(
        file="lib.h5",
        coverage_rad=6.2,
        torus_coverage=0.95,
        worst_hole_rad=0.33,
        worst_hole_phase_x_rad=-0.1,
        worst_hole_phase_y_rad=-1.1,
        phase_rms_error_rad=0.1,
        phase_max_error_rad=0.6,
        mean_transmittance=0.9,
        mean_overlap=0.94,
        cd_phase_rms_rad=0.49,
        index_phase_error_rad=0.03,
        points_solved=120,
        points_total=5776,
        max_error=1.7e-3,
        rounds=3,
    )
    summary = RunSummary(
        name="closed_form",
        library=library,
        phase=PhaseFigures(peak_gain=1.36, rotation_deg=-160.0),
        layout=layout,
        drc=DrcFigures(7213, {"min_gap": 0, "min_feature": 3}, 100.0, "lattice", ("layout.gds", "layout.oas")),
        psf=PsfFigures.compared(psf, ideal, verified=np.ones(psf.depth_m.size, dtype=bool)),
        decode=replace(DecodeFigures.of(decoded_image()), seconds=0.12),
        seconds={"library": 3.1, "layout": 0.5, "psf": 0.8},
        peak_rss_mb={"library": 210.0, "layout": 180.0, "psf": 260.0},
        skipped=(SkippedStep("library", "its <inputs> and its files are unchanged"),),
        versions={"metafab": "0.1.0", "numpy": "2.3"},
    )
    return replace(summary, error_budget=error_budget(summary))


def closed_form_run(folder: Path, library: Library) -> RunFolder:
    """A run folder in which nothing is missing."""
    angle = np.linspace(-np.pi, np.pi, 64)
    phase = np.stack([angle[:, None] + angle[None, :], angle[:, None] - angle[None, :]])
    return RunFolder(
        path=folder,
        summary=run_summary(),
        outline=DesignOutline(
            "closed_form",
            aperture_um=35.0,
            aperture_shape="circle",
            focal_length_mm=20.0,
            terms=("spiral_zones", "split_lens"),
        ),
        library=library,
        phases=AperturePhases(phase, 17.5),
        pillars=pillar_map(),
        mask_file="layout.oas",
        psf=turning_psf(0.6),
        ideal_psf=turning_psf(0.9),
        raw=raw_frame(),
        decoded=decoded_image(),
        notes={"outline": "made in memory"},
    )
