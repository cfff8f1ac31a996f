"""Figures of merit of the written mask, compared with the target phases, a standard lens and measured values."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from metafab.core.conventions import POLARISATIONS, FloatArray
from metafab.core.errors import InputError
from metafab.core.figures import AberrationFigures, FocusFigures, Loss, SpaceVariance, Wavefront
from metafab.core.storage.files import write_json
from metafab.core.storage.pictures import read_grey
from metafab.core.storage.tables import optional, typed
from metafab.spec import Design
from metafab.spec.design import Measured
from metafab.spec.terms import Lens, Picture, Radial, SplitLens, forms_images
from metafab.steps.job import Job, Step, in_folder, no_mask
from metafab.steps.layout import mask_paths
from metafab.steps.library import open_library
from metafab.steps.optics.sources import lit_source, written_light
from metafab.steps.orders import recorded_coupling

if TYPE_CHECKING:
    from metafab.optics import Imaging, Psf
    from metafab.optics.measures.focus import LensFocus

#: Number of frequencies of the modulation transfer, evenly spaced up to the cut-off of the lens.
_FREQUENCIES = 33
#: Sites across a lens, at least, for a wavefront of 36 polynomials.
_FEWEST_SITES = 24


@dataclass(frozen=True)
class ModulationFigures:
    """Modulation transfer of the pair, per transmitted power, and of a standard lens, mean over directions."""

    frequency_per_mm: FloatArray  #: Shape (n,), spatial frequency on the sensor.
    #: Shape (n_depth, n), modulation transfer of PSF_x at each depth; NaN where the window misses or cuts the light.
    pair_x: FloatArray
    pair_y: FloatArray  #: Shape (n_depth, n), modulation transfer of PSF_y.
    #: Shape (n_depth, n), modulation transfer of a lens of equal aperture, focused at the focus depth.
    lens: FloatArray


@dataclass(frozen=True)
class LossChainFigures:
    """Factors between the light at the aperture and that in a pinhole, a picture's frame, or the target wave."""

    depth_m: float  #: Verified depth nearest to the focus depth, in vergence.
    wavefront: Wavefront  #: Overlap of the written field with the target wave.
    losses: tuple[Loss, ...]  #: The factors, in order.
    efficiency: tuple[float, ...]  #: Share of the light at the end of the chain, x and y polarisation.


@dataclass(frozen=True, kw_only=True)
class SpaceVarianceFigures(SpaceVariance):
    """Aberrations over the field at one depth, and the depth bias that they cause."""

    depth_m: float  #: Object depth.
    #: Shape (2, n_y, n_x), vergence of the most similar PSF on the axis minus that of the object.
    seen_bias_dioptre: FloatArray


@dataclass(frozen=True)
class MeritFigures:
    """Figures of merit at the verified depths."""

    depth_m: tuple[float, ...]  #: Object depths.
    pinhole_um: float  #: Diameter of the pinhole about the image point.
    #: Share of the light at the aperture through the pinhole, for each depth; likewise y.
    pinhole_efficiency_x: tuple[float, ...]
    pinhole_efficiency_y: tuple[float, ...]
    ideal_pinhole_efficiency_x: tuple[float, ...]  #: Pinhole efficiency of the target phases; likewise y.
    ideal_pinhole_efficiency_y: tuple[float, ...]
    #: (x, y) of the main lobe of PSF_x from the image point, for each depth; likewise y.
    main_lobe_x_um: tuple[tuple[float, ...], ...]
    main_lobe_y_um: tuple[tuple[float, ...], ...]
    #: Rotation of the pair from the nearest to the farthest depth; ``ideal_rotation_deg``: that of the target phases.
    rotation_deg: float
    ideal_rotation_deg: float
    #: Range of vergence in which the peak exceeds 80 % of its maximum, x and y polarisation.
    depth_of_field_dioptre: tuple[float, ...]
    extinction_ratio: tuple[float, ...]  #: Wanted over unwanted power, for each depth.
    modulation: ModulationFigures  #: Modulation transfer.
    loss_chain: LossChainFigures  #: Losses from the aperture to the image.
    space_variance: SpaceVarianceFigures | None  #: Aberrations over the field; None without a field.
    measured: Measured | None  #: Values measured on the fabricated device; None if the design states none.
    #: See :class:`metafab.core.figures.FocusFigures`; this and the next four are copies of ``focus``.
    fwhm_x_um: float | None = optional()
    fwhm_y_um: float | None = optional()
    fwhm_limit_um: float | None = optional()
    strehl: float | None = optional()
    encircled_energy: float | None = optional()
    #: Peak over that of the target phases, for each depth, not per transmitted power; likewise y. None where the window
    #: misses or cuts the light, as both peaks are then stray light.
    relative_peak_x: tuple[float, ...] | None = optional()
    relative_peak_y: tuple[float, ...] | None = optional()
    #: Share of the light at the aperture in the frame of a hologram's picture at the focus depth, mean over the
    #: polarisations whose picture the window holds; None without any.
    picture_efficiency: float | None = optional()
    focus: FocusFigures | None = optional()  #: The focus of a lens; None for other devices.
    #: Wavefront of a lens at the focus depth, for each polarisation that it focuses; None for other devices and where
    #: too few places transmit for 36 polynomials.
    aberrations: tuple[AberrationFigures, ...] | None = optional()


def _merit(job: Job) -> MeritFigures:
    from metafab import optics
    from metafab.optics.interpolation import without_depths
    from metafab.optics.measures import landing, metrics

    whole, ideal = (optics.load(job.folder / name) for name in ("psf.h5", "ideal_psf.h5"))
    written = without_depths(whole, ~np.isin(whole.depth_m, ideal.depth_m))
    imaging = optics.Imaging.of(job.design)
    # The pinhole of the paper, or the largest that fits in the window.
    wanted_um = metrics.PINHOLE_UM if job.design.measured is None else job.design.measured.pinhole_um
    pinhole_um = metrics.largest_pinhole_um(written, wanted_um)
    passed, ideal_passed = (metrics.pinhole_efficiency(psf, pinhole_um) for psf in (written, ideal))
    lobes, source = metrics.main_lobe_um(written), lit_source(job, written_light(job, mask_paths(job)[-1]))
    is_seen = landing.light_elsewhere(source, imaging, written) is None and not metrics.peak_on_edge(whole)
    table = {
        "depth_m": written.depth_m,
        "pinhole_um": pinhole_um,
        **{f"pinhole_efficiency_{p}": passed[i] for i, p in enumerate("xy")},
        **{f"ideal_pinhole_efficiency_{p}": ideal_passed[i] for i, p in enumerate("xy")},
        **{f"main_lobe_{p}_um": lobes[i] for i, p in enumerate("xy")},
        "rotation_deg": metrics.rotation_deg(written),
        "ideal_rotation_deg": metrics.rotation_deg(ideal),
        "depth_of_field_dioptre": metrics.depth_of_field_dioptre(whole),
        "extinction_ratio": written.extinction_ratio,
        "modulation": _modulation(job, imaging, written, is_seen=is_seen),
        "loss_chain": _loss_chain(job, written, ideal, passed, ideal_passed),
        "space_variance": _space_variance(imaging, whole),
        "measured": job.design.measured,
    }
    if is_seen:
        table |= dict(zip(("relative_peak_x", "relative_peak_y"), metrics.relative_peak(written, ideal), strict=True))
    figures = replace(typed(MeritFigures, table), picture_efficiency=_mean_share(_framed(job.design, written)))
    if job.design.is_lens:
        focus = focus_figures(job, imaging, mask_paths(job)[-1])
        figures = replace(
            figures,
            fwhm_x_um=focus.fwhm_x_um,
            fwhm_y_um=focus.fwhm_y_um,
            fwhm_limit_um=focus.fwhm_limit_um,
            strehl=focus.strehl,
            encircled_energy=focus.encircled_energy,
            focus=focus,
            aberrations=_wavefronts(job, imaging, mask_paths(job)[-1]),
        )
    write_json(job.folder / "merit.json", figures)
    return figures


def _framed(design: Design, psf: Psf) -> FloatArray:
    """Share of the light within the frames of the pictures, shape (2,); NaN without one in the window."""
    from metafab.optics.measures.metrics import frame_efficiency

    depth, shares = _focus_index(design, psf), np.full(2, np.nan)
    # A window that was moved is not centred on the picture.
    for term in design.phase if design.verify.centre_um is None else ():
        if isinstance(term, Picture):
            rows, columns = read_grey(term.file).shape
            share = frame_efficiency(psf, term.width_um, term.width_um * rows / columns)[:, depth]
            own = [term.polarisation in (None, p) for p in POLARISATIONS]
            shares = np.where(own, share, shares)
    return shares


def _mean_share(shares: FloatArray) -> float | None:
    """Mean over the polarisations that have a picture; None without any."""
    return float(np.nanmean(shares)) if np.isfinite(shares).any() else None


def _focus_index(design: Design, psf: Psf) -> int:
    """Number of the depth nearest to the focus depth, in vergence."""
    return int(np.argmin(np.abs(1.0 / psf.depth_m - 1.0 / design.sensor.focus_depth_m)))


def _wavefronts(job: Job, imaging: Imaging, mask_path: Path) -> tuple[AberrationFigures, ...] | None:
    """Wavefront of a lens at the focus depth, for each focused polarisation; None where too few places transmit."""
    from metafab import layout
    from metafab.optics.measures.aberrations import aberrations

    design = job.design
    if min(layout.lattice_of(design).shape) < _FEWEST_SITES:
        return None
    source, depth_m = lit_source(job, written_light(job, mask_path)), design.sensor.focus_depth_m
    try:
        return tuple(aberrations(source, imaging, depth_m, polarisation=i, work=job.work) for i in _focused(design))
    except InputError:  # A thin ring transmits through too few blocks.
        return None


def focus_figures(job: Job, imaging: Imaging, mask_path: Path) -> FocusFigures:
    """Return the focus of a lens from its mask file, at the focus depth."""
    from metafab.optics.measures.focus import focus

    lens = lens_focus(job.design, imaging)
    return focus(
        lit_source(job, written_light(job, mask_path)),
        replace(lens, perfect=lit_source(job, lens.perfect)),
        imaging,
        target_error=job.design.verify.target_error,
        work=job.work,
    )


def lens_focus(design: Design, imaging: Imaging) -> LensFocus:
    """Return the focus of a lens: its ideal lens, depth and polarisations."""
    from metafab import layout, optics
    from metafab.optics.measures.focus import LensFocus, PerfectLens

    depth_m = design.sensor.focus_depth_m
    perfect = optics.ideal_field(PerfectLens(imaging, depth_m), layout.lattice_of(design), design.device)
    return LensFocus(perfect, depth_m, _focused(design))


def _focused(design: Design) -> tuple[int, ...]:
    """Polarisations that the design focuses, 0 for x and 1 for y."""
    lenses = [term.polarisation for term in design.phase if isinstance(term, Lens | Radial | SplitLens)]
    return tuple(i for i, p in enumerate(POLARISATIONS) if None in lenses or p in lenses)


def _modulation(job: Job, imaging: Imaging, written: Psf, *, is_seen: bool) -> ModulationFigures:
    from metafab.optics.measures.mtf import lens_cut_off_per_um, lens_modulation, modulation_transfer

    device, focus_m = job.design.device, job.design.sensor.focus_depth_m
    cut_off = lens_cut_off_per_um(imaging)
    frequency = np.linspace(0.0, cut_off, _FREQUENCIES)
    rings, pair = modulation_transfer(written)
    frequency = frequency[frequency <= rings[-1]]
    pair_x, pair_y = (np.array([np.interp(frequency, rings, curve) for curve in curves]) for curves in pair)
    if not is_seen:
        pair_x, pair_y = np.full_like(pair_x, np.nan), np.full_like(pair_y, np.nan)
    lens = [lens_modulation(imaging, device, float(z), frequency, focus_m) for z in written.depth_m]
    return ModulationFigures(1e3 * frequency, pair_x, pair_y, np.array(lens))


def _transmitted(psf: Psf) -> FloatArray:
    """Transmitted share of each polarisation in that polarisation; ghosts of a substrate are left out."""
    transmitted = np.array(psf.details.transmitted)
    if psf.ghost is None:
        return transmitted
    middle = psf.depth_m.size // 2
    own, crossed = psf.efficiency[:, middle], psf.ghost.efficiency[::-1, middle]
    return np.asarray(transmitted * own / (own + crossed))


def _loss_chain(job: Job, written: Psf, ideal: Psf, passed: FloatArray, ideal_passed: FloatArray) -> LossChainFigures:
    """Losses at the verified depth nearest to the focus depth; ``passed`` has shape (2, n_depth)."""
    from metafab import optics
    from metafab.optics.measures.chain import loss_chain, wavefront

    depth = _focus_index(job.design, written)
    source = written_light(job, mask_paths(job)[-1])
    front = wavefront(source, job.profile, job.design.device, open_library(job))
    coupling = recorded_coupling(job)
    # The model of neighbours already takes their loss out of the written field.
    has_neighbours = isinstance(source, optics.NeighbourField)
    kept = (
        None if coupling is None or has_neighbours else (coupling.polarised_ratio or (coupling.efficiency_ratio,) * 2)
    )
    transmitted = _transmitted(written)
    open_ahead = optics.Apodisation.of(job.design) is None and job.design.substrate is None
    stopped = None if open_ahead else _transmitted(ideal)
    end: dict[str, Any] = {}
    framed = [_framed(job.design, psf) for psf in (written, ideal)]
    if np.isfinite(framed).all():
        end = {"passed": framed[0], "ideal_passed": framed[1], "opening": "frame of the picture"}
    elif job.design.measured is not None or forms_images([term.term for term in job.design.phase]):
        end = {"passed": passed[:, depth], "ideal_passed": ideal_passed[:, depth]}
    losses = loss_chain(front, transmitted, coupling=kept, stopped=stopped, **end)
    table = {
        "depth_m": written.depth_m[depth],
        "wavefront": front,
        "losses": losses,
        "efficiency": np.prod([loss.factor for loss in losses if loss.factor is not None], axis=0),
    }
    return typed(LossChainFigures, table)


def _space_variance(imaging: Imaging, written: Psf) -> SpaceVarianceFigures | None:
    """Aberrations and depth bias over the field at the middle depth; None without a field."""
    from metafab.optics.measures.space_variance import depth_bias_dioptre, space_variance

    if written.field is None:
        return None
    middle_m = float(written.depth_m[written.depth_m.size // 2])
    field = space_variance(imaging, written.field.tangent_x, written.field.tangent_y, middle_m)
    bias_dioptre = depth_bias_dioptre(written)
    return SpaceVarianceFigures(**vars(field), depth_m=middle_m, seen_bias_dioptre=bias_dioptre)


MERIT = Step(
    name="merit",
    rooms=("mask", "library", "optics", "phase"),
    after=("library", "phase", "layout", "psf", "orders"),
    inputs=lambda d: (d.measured, d.sensor, d.device),
    outputs=in_folder("merit.json"),
    work=_merit,
    figures=MeritFigures,
    not_needed=no_mask,
    reads=("coupling.json",),
    is_beside=True,
)
