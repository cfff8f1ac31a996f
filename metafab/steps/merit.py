"""Figures of merit of the written mask, beside the target phases, a standard lens, and what was measured."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from metafab.steps.budget import recorded_coupling
from metafab.steps.job import Job, Step
from metafab.steps.layout import mask_paths
from metafab.steps.library import open_library
from metafab.steps.optics import mask_source
from metafab.steps.outputs import in_folder, no_mask

if TYPE_CHECKING:
    from metafab.optics import Imaging, Psf

#: Frequencies at which modulation transfer is listed, as shares of the lens' cut-off.
_FREQUENCIES = 33


def _merit(job: Job) -> dict[str, Any]:
    from metafab import optics
    from metafab.core.storage.files import write_json

    whole, ideal = (optics.load(job.folder / name) for name in ("psf.h5", "ideal_psf.h5"))
    written = optics.without_depths(whole, ~np.isin(whole.depth_m, ideal.depth_m))
    imaging, metrics = optics.Imaging.of(job.design), optics.metrics
    # The paper's pinhole, or the largest that can be scanned over the window.
    wanted_um = metrics.PINHOLE_UM if job.design.measured is None else job.design.measured.pinhole_um
    pinhole_um = metrics.largest_pinhole_um(written, wanted_um)
    passed, ideally = (metrics.pinhole_efficiency(psf, pinhole_um) for psf in (written, ideal))
    strehl, lobes = metrics.relative_peak(written, ideal), metrics.main_lobe_um(written)
    found = {
        "depth_m": written.depth_m,
        "pinhole_um": pinhole_um,
        **{f"pinhole_efficiency_{p}": passed[i] for i, p in enumerate("xy")},
        **{f"ideal_pinhole_efficiency_{p}": ideally[i] for i, p in enumerate("xy")},
        **{f"strehl_{p}": strehl[i] for i, p in enumerate("xy")},
        **{f"main_lobe_{p}_um": lobes[i] for i, p in enumerate("xy")},
        "rotation_deg": metrics.rotation_deg(written),
        "ideal_rotation_deg": metrics.rotation_deg(ideal),
        "depth_of_field_dioptre": metrics.depth_of_field_dioptre(whole),
        "extinction_ratio": written.extinction_ratio,
        "modulation": _modulation(job, imaging, written),
        "loss_chain": _loss_chain(job, written, ideal, passed, ideally),
        "space_variance": _space_variance(imaging, whole),
        "measured": job.design.measured,
    }
    write_json(job.folder / "merit.json", found)
    return found


def _modulation(job: Job, imaging: Imaging, written: Psf) -> dict[str, Any]:
    """MTF of the pair and of a standard lens, each depth, per mm on the sensor."""
    from metafab import optics

    device, focus_m = job.design.device, job.design.sensor.focus_depth_m
    cut_off = device.aperture_um / (imaging.wavelength_um * imaging.sensor_distance_um)
    frequency = np.linspace(0.0, cut_off, _FREQUENCIES)
    rings, pair = optics.modulation_transfer(written)
    frequency = frequency[frequency <= rings[-1]]
    shown = np.array([[np.interp(frequency, rings, curve) for curve in curves] for curves in pair])
    lens = [optics.lens_modulation(imaging, device, float(z), frequency, focus_m) for z in written.depth_m]
    return {"frequency_per_mm": 1e3 * frequency, "pair_x": shown[0], "pair_y": shown[1], "lens": np.array(lens)}


def _transmitted(psf: Psf) -> np.ndarray:
    return np.array([float(psf.details[f"transmitted_{p}"]) for p in "xy"])


def _loss_chain(job: Job, written: Psf, ideal: Psf, passed: np.ndarray, ideally: np.ndarray) -> dict[str, Any]:
    """Where the light goes that is to pass the pinhole, at the depth nearest to the sharp one."""
    from metafab import optics

    depth = int(np.argmin(np.abs(1.0 / written.depth_m - 1.0 / job.design.sensor.focus_depth_m)))
    source = mask_source(job, mask_paths(job)[-1])
    front = optics.wavefront(source, job.profile, job.design.device, open_library(job))
    coupling = recorded_coupling(job).get("efficiency_ratio")
    transmitted = _transmitted(written)
    stopped = None if optics.Apodisation.of(job.design) is None else _transmitted(ideal)
    losses = optics.loss_chain(front, transmitted, passed[:, depth], ideally[:, depth], coupling, stopped)
    return {
        "depth_m": written.depth_m[depth],
        "wavefront": front,
        "losses": losses,
        "efficiency": passed[:, depth] * (1.0 if coupling is None else coupling),
    }


def _space_variance(imaging: Imaging, written: Psf) -> dict[str, Any] | None:
    """Image points, aberrations and the depth bias that the PSFs show, over the field; None without one."""
    from metafab import optics

    if written.field is None:
        return None
    middle = float(written.depth_m[written.depth_m.size // 2])
    field = optics.space_variance(imaging, written.field.tangent_x, written.field.tangent_y, middle)
    return {
        "depth_m": middle,
        "tangent_x": field.tangent_x,
        "tangent_y": field.tangent_y,
        "defocus_dioptre": field.defocus_dioptre,
        "astigmatism_dioptre": field.astigmatism_dioptre,
        "seen_bias_dioptre": optics.seen_bias_dioptre(written),
        "distortion_um": field.distortion_um,
    }


MERIT = Step(
    "merit", ("mask", "library", "optics", "phase"), ("library", "phase", "layout", "psf"),
    lambda d: (d.measured, d.sensor, d.device), in_folder("merit.json"), _merit, no_mask,
    reads=("coupling.json",),
)  # fmt: skip
