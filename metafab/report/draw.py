"""Figures of a run: each is drawn once, saved as PNG, and returned as SVG for the page."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from metafab.core.conventions import POLARISATIONS
from metafab.core.parallel.forked import shared
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.pictures import read_grey
from metafab.layout import Outline
from metafab.optics import Psf
from metafab.optics.measures.mtf import modulation_transfer
from metafab.optics.point_spread import NeighbourMap
from metafab.report.accounts import depths_against_truth, loss_chain
from metafab.report.figures import accounts, exposure, image, library, mask, phases, psf, study
from metafab.report.figures.mask import picture_of
from metafab.report.render import save_both
from metafab.report.run_folder import RunFolder
from metafab.report.style import BARS, MAP, PICTURE, PLOT, Margins, depth_text, panel
from metafab.spec.terms import Picture
from metafab.steps.optics.merit import MeritFigures

#: Least end of the scale of size errors (nm), for lenses that print without any.
_LEAST_NM = 1e-3


@dataclass(frozen=True)
class Plan:
    """Plan of a figure."""

    name: str  #: File name without suffix, and prefix of the identifiers in the SVG.
    label: str  #: Text for screen readers.
    paint: Callable[[Axes], object]  #: Draws on the axes.
    size_in: tuple[float, float] = (4.0, 3.1)  #: Width and height in inches.
    margins_in: Margins = PLOT  #: Left, right, bottom and top margins around the axes.

    def figure(self) -> Figure:
        """The drawn figure."""
        figure, axes = panel(self.size_in, self.margins_in)
        self.paint(axes)
        return figure


def draw(
    run: RunFolder, progress: Progress = silent, workers: int | None = None, only: Collection[str] | None = None
) -> dict[str, str]:
    """Draw all figures of a run, or those named in ``only``, into ``figures/``; those of earlier runs are removed.

    Returns:
        The figures as SVG by name.
    """
    folder = run.path / "figures"
    folder.mkdir(exist_ok=True)
    rooms = (_accounts, _library, _design, _exposure, _hologram, _fullwave, _study, _light, _image, _comparison)
    plans = [plan for room in rooms for plan in room(run) if only is None or plan.name in only]
    drawn: dict[str, str] = {}
    progress("figures", 0, len(plans))
    for plan, text in zip(plans, shared(partial(_drawn, folder=folder), plans, workers), strict=True):
        drawn[plan.name] = text
        progress("figures", len(drawn), len(plans))
    for path in folder.glob("*.png"):
        if path.stem not in drawn:
            path.unlink()
    return drawn


def _drawn(plan: Plan, folder: Path) -> str:
    """Write the figure as PNG into ``folder`` and return it as SVG."""
    return save_both(plan.figure(), folder / f"{plan.name}.png", plan.label)


def _accounts(run: RunFolder) -> Iterator[Plan]:
    chain = loss_chain(run)
    budget = [line for line in run.summary.error_budget if line.value is not None and line.value > 0.0]
    if chain:
        yield _bars("loss_chain", "Loss chain", partial(accounts.loss_chain, chain), len(chain))
    # Bars compare lengths, so each unit has its own panel.
    for number, unit in enumerate(dict.fromkeys(line.unit for line in budget), 1):
        lines = [line for line in budget if line.unit == unit]
        if len(lines) > 1:  # One bar alone compares nothing; the table has its value.
            paint = partial(accounts.error_budget, lines)
            yield _bars(f"error_budget_{number}", f"Error budget, {unit}", paint, len(lines))


def _bars(name: str, label: str, paint: Callable[[Axes], object], count: int) -> Plan:
    return Plan(name, label, paint, (4.6, 0.94 + 0.42 * count), BARS)


def _image_map(name: str, label: str, paint: Callable[[Axes], object], shape: tuple[int, ...], side_in: float) -> Plan:
    """Plan of a picture with a colour bar; the longer side of the axes is ``side_in``."""
    n_y, n_x = shape
    scale = side_in / max(n_y, n_x)
    left, right, bottom, top = MAP
    return Plan(name, label, paint, (n_x * scale + left + right, n_y * scale + bottom + top), MAP)


def _map(name: str, label: str, paint: Callable[[Axes], object]) -> Plan:
    return Plan(name, label, paint, (4.0, 3.1), MAP)


def _library(run: RunFolder) -> Iterator[Plan]:
    if run.library is None:
        return
    for p in POLARISATIONS:
        phase = partial(library.phase_map, run.library, polarisation=p)
        yield _map(f"library_phase_{p}", f"Phase of t over width and length, {p} polarisation", phase)
        share = partial(library.transmittance_map, run.library, polarisation=p)
        yield _map(f"library_transmittance_{p}", f"Transmittance over width and length, {p} polarisation", share)
    pairs = partial(library.coverage, run.library, reached=run.summary.library)
    yield _map("coverage", "Pairs of phases that the library reaches", pairs)
    yield _map("library_error", "Error over width and length", partial(library.error_map, run.library))


def _design(run: RunFolder) -> Iterator[Plan]:
    if run.phases is not None and run.phases.vary:
        content = f"Without {run.outline.carriers}" if run.outline.carriers else "Target phase"
        if "spiral_zones" in run.outline.terms:
            content = "Spiral zones"
        for row, p in enumerate(POLARISATIONS):
            paint = partial(
                phases.aperture_phase,
                run.phases.phase_rad[row],
                run.phases.half_side_um,
                polarisation=p,
                title=f"{content}, {p} polarisation",
            )
            yield Plan(f"phase_{p}", f"Target phase over the aperture, {p} polarisation", paint, (4.0, 3.4), PICTURE)
    if run.pillars is None:
        return
    unit_nm = run.pillars.lattice.database_unit_nm
    outline = Outline("rectangle", unit_nm) if run.design is None else Outline.of(run.design)
    picture = picture_of(run.pillars, outline)
    lens = partial(mask.fill_map, picture.fill, picture.half_side_um, marks_um=picture.frames_um())
    yield Plan("mask", "Pillar coverage over the whole mask", lens, (4.0, 3.4), PICTURE)
    wide, close = picture.zooms
    if wide.size:
        paint = partial(mask.pillar_outlines, wide, title="A region", outline=outline)
        yield Plan("mask_wide", "Pillars of a region", paint, (4.0, 3.4))
    if close.size:
        paint = partial(mask.pillar_outlines, close, title="Single pillars", outline=outline, label_nearest=True)
        yield Plan("mask_close", "Single pillars with their sizes", paint, (4.0, 3.4))


def _exposure(run: RunFolder) -> Iterator[Plan]:
    record = run.exposure
    if record is None:
        return
    parts = {"one dose": record.plain}
    if record.corrected is not None:
        parts[f"corrected {record.correction}s"] = record.corrected
    # Blocks on the rim hold few pillars and do not set the scale, which both maps share.
    bias_nm = np.abs(record.plain.size_map.bias_nm[np.isfinite(record.plain.size_map.bias_nm)])
    largest_nm = max(_LEAST_NM, float(np.percentile(bias_nm, 99.0))) if bias_nm.size else 1.0
    for name, (title, errors) in zip(("plain", "corrected"), parts.items(), strict=False):
        paint = partial(exposure.size_map, errors.size_map, title=title.capitalize(), largest_nm=largest_nm)
        yield Plan(f"exposure_map_{name}", f"Mean size error over the lens, {title}", paint, (4.0, 3.4), PICTURE)
    yield Plan("exposure_histogram", "Size errors of all pillars", partial(exposure.size_histogram, parts))
    yield Plan("exposure_window", "Size errors over the dose", partial(exposure.process_window, parts))


def _hologram(run: RunFolder) -> Iterator[Plan]:
    """The target picture of a hologram, and the picture of the written file."""
    if run.design is None or run.psf is None:
        return
    for term in run.design.phase:
        if isinstance(term, Picture) and term.file.is_file():
            reach_um = 0.5 * max(run.psf.psf.shape[2:]) * run.psf.pixel_um
            wanted = partial(phases.wanted_picture, read_grey(term.file), term.width_um, reach_um)
            yield Plan("hologram_wanted", "Target picture", wanted, (4.0, 3.4), PICTURE)
            painted = partial(phases.painted_picture, run.psf, polarisation=term.polarisation or "x")
            yield Plan("hologram_found", "Picture of the written file", painted, (4.0, 3.4), PICTURE)
            return


def _study(run: RunFolder) -> Iterator[Plan]:
    if run.study is None:
        return
    lobe, bounds, bandwidth = run.study.lobe, run.study.bounds, run.study.bandwidth
    if lobe is not None:
        yield Plan("lobe_peak", "Peak of the main lobe over one turn", partial(study.lobe_peak, lobe))
        yield Plan("lobe_orientation", "Orientation of the lobe over one turn", partial(study.lobe_orientation, lobe))
    if bounds is not None:
        point, texture = (partial(study.depth_bounds, bounds, of=of) for of in ("point", "texture"))
        yield Plan("bounds_point", "Smallest error of depth from a known point source, four masks", point)
        yield Plan("bounds_texture", "Smallest error of depth from unknown texture, four masks", texture)
    if bandwidth is not None:
        yield Plan("filter", "Error of depth against the filter's width", partial(study.filter_tradeoff, bandwidth))
        turned = partial(study.filter_orientation, bandwidth)
        yield Plan("filter_orientation", "Information kept against the direction of the split", turned)


def _fullwave(run: RunFolder) -> Iterator[Plan]:
    if run.psf is not None and run.psf.neighbours is not None:
        yield from _neighbours(run.psf.neighbours)
    patch = run.patch
    if patch is None:
        return
    places = patch.x_um, patch.y_um
    largest = float(max(np.abs(patch.full_wave).max(), np.abs(patch.library).max()))
    for name, title, field in (("meep", "By Meep", patch.full_wave), ("library", "By the library", patch.library)):
        phase = partial(mask.patch_phase, field, *places, title=title)
        yield Plan(f"patch_phase_{name}", f"Phase behind a patch, {title.lower()}", phase, (4.0, 3.4), PICTURE)
        share = partial(mask.patch_amplitude, field, *places, title=title, largest=largest)
        yield Plan(f"patch_amplitude_{name}", f"Amplitude behind a patch, {title.lower()}", share, (4.0, 3.4), PICTURE)
    differences = [
        ("library", "Difference", patch.full_wave - patch.library),
        ("coupling", "Difference from single pillars on Meep's grid", patch.full_wave - patch.alone),
    ]
    if patch.neighbours is not None:
        differences.append(("model", "Difference from the model of neighbours", patch.among - patch.neighbours))
    for name, title, difference in differences:
        paint = partial(mask.patch_amplitude, difference, *places, title=title, largest=largest)
        yield Plan(f"patch_difference_{name}", title, paint, (4.0, 3.4), PICTURE)


def _neighbours(found: NeighbourMap) -> Iterator[Plan]:
    """Maps of the light that neighbours change and keep, each on one scale for both polarisations."""
    for name, label, values in (
        ("change", "rms change / rms field", found.change),
        ("kept", "light kept in the wave", found.kept),
    ):
        # Blocks on the rim hold few pillars and do not set the scale.
        low, high = np.nanpercentile(values, (2.0, 98.0)) if np.isfinite(values).any() else (0.0, 1.0)
        for p, of_light in zip(POLARISATIONS, values, strict=True):
            title = f"{p} polarised"
            paint = partial(
                mask.neighbour_map, of_light, found.x_um, found.y_um, label=label, title=title, scale=(low, high)
            )
            text = f"Over the aperture, {label}, among unlike neighbours, {title}"
            yield Plan(f"neighbours_{name}_{p}", text, paint, (4.0, 3.4), PICTURE)


def _comparison(run: RunFolder) -> Iterator[Plan]:
    if run.comparison is None:
        return
    depth = partial(study.rival_depth_errors, run.comparison)
    yield Plan("rival_depth", "Error of depth over depth, with other cameras", depth, (4.6, 3.4))
    sharp = partial(study.rival_sharpness, run.comparison)
    yield Plan("rival_sharpness", "Sharpness over depth, with other cameras", sharp, (4.6, 3.4))


def _light(run: RunFolder) -> Iterator[Plan]:
    pair, ideal, merit = run.psf, run.ideal_psf, run.summary.merit
    if pair is None:
        return
    size = (1.15 * psf.shown_depths(pair).size + 0.4, 2.66)
    both = partial(psf.pair_over_depth, pair, arrows=run.has_lobe)
    yield Plan("psf_pair", "PSF pair over depth", both, size, (0.3, 0.1, 0.05, 0.3))
    if pair.depth_m.size > 1:
        yield from _over_depth(run, pair, ideal)
    if merit is not None and merit.focus is not None:
        paint = partial(psf.focus_section, merit.focus)
        yield Plan("psf_focus", "Cross-sections of the focus, and of an ideal flat lens", paint)
    for front in (merit and merit.aberrations) or ():
        paint = partial(psf.wavefront_map, front)
        yield Plan(f"wavefront_{front.polarisation}", "Wavefront error over the aperture", paint, (4.0, 3.4), PICTURE)
    if run.forms_images:
        yield _modulation(pair, merit, run.psf_source)
    space = None if merit is None else merit.space_variance
    if space is not None and space.tangent_x.size > 1:
        yield Plan("depth_bias", "Depth bias of both polarisations over the field", partial(psf.depth_bias, space))
        shift = partial(psf.distortion, space)
        yield Plan("distortion", "Distortion of both images over the field of view", shift)
    if pair.field is not None:
        for p in POLARISATIONS:
            paint = partial(psf.over_field, pair, polarisation=p)
            yield Plan(f"psf_field_{p}", f"PSF of {p} polarisation over the field of view", paint, (4.0, 3.6))


def _over_depth(run: RunFolder, pair: Psf, ideal: Psf | None) -> Iterator[Plan]:
    """Curves over several depths; a focus on its image point has no orientation."""
    if run.has_lobe:
        yield Plan("psf_orientation", "Orientation over depth", partial(psf.orientation, pair, ideal=ideal))
    peak = partial(psf.peak, pair, ideal=ideal, source=run.psf_source)
    yield Plan("psf_peak", "Peak irradiance over depth", peak)


def _modulation(pair: Psf, merit: MeritFigures | None, source: str) -> Plan:
    """Plan of the modulation transfer; its curves are named by their depths, one alone by the ``source``."""
    depth_m = pair.depth_m.tolist() if merit is None else merit.depth_m
    names = [depth_text(each) for each in depth_m] if len(depth_m) > 1 else [source]
    if merit is None:
        frequency_per_um, pairs = modulation_transfer(pair)
        curves = {names[d]: pairs[0, d] for d in _three(len(depth_m))}
        return Plan("psf_mtf", "Modulation transfer", partial(psf.modulation, 1e3 * frequency_per_um, curves))
    transfer, chosen = merit.modulation, _three(len(depth_m))
    curves = {names[d]: transfer.pair_x[d] for d in chosen}
    lens = [transfer.lens[d] for d in chosen]
    mtf = partial(psf.modulation, transfer.frequency_per_mm, curves, lens=lens)
    return Plan("psf_mtf", "Modulation transfer, and that of an ideal lens of equal aperture", mtf)


def _three(count: int) -> list[int]:
    """Indices of the nearest, the middle and the farthest depth."""
    return list(dict.fromkeys((0, count // 2, count - 1)))


def _image(run: RunFolder) -> Iterator[Plan]:
    if run.raw is not None:
        yield _image_map("raw_frame", "Raw frame", partial(image.raw_frame, run.raw), run.raw.frame.shape, 6.7)
    decoded = run.decoded
    if decoded is not None:
        image_map = partial(_image_map, shape=decoded.depth_m.shape, side_in=2.8)
        for p in POLARISATIONS:
            paint = partial(image.intensity, decoded, polarisation=p)
            yield image_map(f"intensity_{p}", f"Decoded intensity of {p} polarisation", paint)
        yield image_map("contrast", "Polarisation contrast", partial(image.contrast, decoded))
        yield image_map("depth", "Decoded depth", partial(image.depth, decoded))
        yield image_map("confidence", "Confidence of the depth", partial(image.confidence, decoded))
    pairs = depths_against_truth(run)
    if pairs is not None:
        paint = partial(image.depth_against_truth, pairs)
        yield Plan("depth_truth", "Decoded against true depth", paint, (3.6, 3.1))
