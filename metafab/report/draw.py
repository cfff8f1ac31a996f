"""Which figures a run has: each drawn once, saved as PNG for papers and slides, and kept as SVG for the page."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from metafab.core.conventions import POLARISATIONS
from metafab.core.parallel.forked import shared
from metafab.core.parallel.progress import Progress
from metafab.core.storage.pictures import read_grey
from metafab.layout import Outline
from metafab.report import figures
from metafab.report.accounts import budget_of, chain_of, depths_against_truth, modulation_of, seconds_of
from metafab.report.mask_picture import picture_of
from metafab.report.render import save_both
from metafab.report.run_folder import RunFolder
from metafab.report.style import BARS, MAP, PICTURE, PLOT, Margins, panel
from metafab.spec.terms import Picture


@dataclass(frozen=True)
class Plan:
    """A figure to be drawn.

    Attributes:
        name: file name without suffix, and prefix of the SVG's identifiers.
        label: what a screen reader says.
        paint: draws on the axes.
        size_in: width and height in inches.
        margins_in: left, right, bottom and top margins around the axes.
    """

    name: str
    label: str
    paint: Callable[[Axes], object]
    size_in: tuple[float, float] = (4.0, 3.1)
    margins_in: Margins = PLOT

    def figure(self) -> Figure:
        """The drawn figure."""
        figure, axes = panel(self.size_in, self.margins_in)
        self.paint(axes)
        return figure


def draw(run: RunFolder, progress: Progress, workers: int | None = None) -> dict[str, str]:
    """Draw all figures of a run into ``figures/`` and return them as SVG by name; pictures of earlier runs go."""
    folder = run.path / "figures"
    folder.mkdir(exist_ok=True)
    plans = [
        *_accounts(run),
        *_library(run),
        *_design(run),
        *_hologram(run),
        *_fullwave(run),
        *_study(run),
        *_light(run),
        *_image(run),
        *_rivals(run),
    ]
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
    """The figure as SVG; as PNG it goes to ``folder``."""
    return save_both(plan.figure(), folder / f"{plan.name}.png", plan.label)


def _accounts(run: RunFolder) -> Iterator[Plan]:
    chain, budget, seconds = chain_of(run), budget_of(run), seconds_of(run)
    if chain:
        yield _bars("loss_chain", "Loss chain", partial(figures.loss_chain, chain), len(chain))
    # Bars compare lengths, so each unit has a panel of its own.
    units = list(dict.fromkeys(unit for _, value, unit in budget if value > 0.0))
    for number, unit in enumerate(units, 1):
        shown = [line for line in budget if line[1] > 0.0 and line[2] == unit]
        paint = partial(figures.error_budget, shown)
        yield _bars(f"error_budget_{number}", f"Error budget, {unit}", paint, len(shown))
    if seconds:
        yield _bars("seconds", "Seconds of each step", partial(figures.seconds, seconds), len(seconds))


def _bars(name: str, label: str, paint: Callable[[Axes], object], count: int) -> Plan:
    return Plan(name, label, paint, (4.6, 0.94 + 0.42 * count), BARS)


def _image_map(name: str, label: str, paint: Callable[[Axes], object], shape: tuple[int, ...], side_in: float) -> Plan:
    """A picture with its colour bar; the axes have the picture's proportions and ``side_in`` at the longer side."""
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
        phase = partial(figures.phase_map, run.library, polarisation=p)
        yield _map(f"library_phase_{p}", f"Phase of t over width and length, {p} polarisation", phase)
        share = partial(figures.transmittance_map, run.library, polarisation=p)
        yield _map(f"library_transmittance_{p}", f"Transmittance over width and length, {p} polarisation", share)
    yield _map("coverage", "Pairs of phases that the library reaches", partial(figures.coverage, run.library))
    yield _map("library_error", "Error over width and length", partial(figures.error_map, run.library))


def _design(run: RunFolder) -> Iterator[Plan]:
    if run.phases is not None and run.phases.vary:
        zones = any(term.get("term") == "spiral_zones" for term in run.design_table.get("phase", []))
        for row, p in enumerate(POLARISATIONS):
            paint = partial(
                figures.aperture_phase,
                run.phases.phase_rad[row],
                run.phases.half_side_um,
                polarisation=p,
                title=f"{'Zones' if zones else 'Beside lens and split'}, {p} polarisation",
            )
            yield Plan(f"phase_{p}", f"Target phase over the aperture, {p} polarisation", paint, (4.0, 3.4), PICTURE)
    if run.pillars is None:
        return
    unit_nm = run.pillars.lattice.database_unit_nm
    outline = Outline("rectangle", unit_nm) if run.design is None else Outline.of(run.design)
    picture = picture_of(run.pillars, outline)
    lens = partial(figures.fill_map, picture.fill, picture.half_side_um, marks_um=picture.frames_um())
    yield Plan("mask", "Pillar coverage over the whole mask", lens, (4.0, 3.4), PICTURE)
    wide, close = picture.zooms
    if wide.size:
        paint = partial(figures.pillar_outlines, wide, title="A region", outline=outline)
        yield Plan("mask_wide", "Pillars of a region", paint, (4.0, 3.4))
    if close.size:
        paint = partial(figures.pillar_outlines, close, title="Single pillars", outline=outline, label_nearest=True)
        yield Plan("mask_close", "Single pillars with their sizes", paint, (4.0, 3.4))


def _hologram(run: RunFolder) -> Iterator[Plan]:
    """The picture that was wanted, and beside it what the written file paints of it."""
    if run.design is None or run.psf is None:
        return
    for term in run.design.phase:
        if isinstance(term, Picture) and term.file.is_file():
            reach_um = 0.5 * max(run.psf.psf.shape[2:]) * run.psf.pixel_um
            wanted = partial(figures.wanted_picture, read_grey(term.file), term.width_um, reach_um)
            yield Plan("hologram_wanted", "The picture that was wanted", wanted, (4.0, 3.4), PICTURE)
            found = partial(figures.painted_picture, run.psf, polarisation=term.polarisation or "x")
            yield Plan("hologram_found", "What the written file paints", found, (4.0, 3.4), PICTURE)
            return


def _study(run: RunFolder) -> Iterator[Plan]:
    if run.study is None:
        return
    lobe, bounds, bandwidth = run.study.lobe, run.study.bounds, run.study.bandwidth
    if lobe is not None:
        yield Plan("lobe_peak", "Peak of the main lobe over one turn", partial(figures.lobe_peak, lobe))
        yield Plan("lobe_orientation", "Orientation of the lobe over one turn", partial(figures.lobe_orientation, lobe))
    if bounds is not None:
        point, texture = (partial(figures.depth_bounds, bounds, of=of) for of in ("point", "texture"))
        yield Plan("bounds_point", "Smallest error of depth from a known point source, four masks", point)
        yield Plan("bounds_texture", "Smallest error of depth from unknown texture, four masks", texture)
    if bandwidth is not None:
        yield Plan("filter", "Error of depth against the filter's width", partial(figures.filter_tradeoff, bandwidth))
        turned = partial(figures.filter_orientation, bandwidth)
        yield Plan("filter_orientation", "Information kept against the direction of the split", turned)


def _fullwave(run: RunFolder) -> Iterator[Plan]:
    patch = run.patch
    if patch is None:
        return
    places = patch.x_um, patch.y_um
    largest = float(max(np.abs(patch.full_wave).max(), np.abs(patch.library).max()))
    for name, title, field in (("meep", "By Meep", patch.full_wave), ("library", "By the library", patch.library)):
        phase = partial(figures.patch_phase, field, *places, title=title)
        yield Plan(f"patch_phase_{name}", f"Phase behind a patch, {title.lower()}", phase, (4.0, 3.4), PICTURE)
        share = partial(figures.patch_amplitude, field, *places, title=title, largest=largest)
        yield Plan(f"patch_amplitude_{name}", f"Amplitude behind a patch, {title.lower()}", share, (4.0, 3.4), PICTURE)
    for name, title, field in (
        ("library", "Difference", patch.library),
        ("coupling", "Difference to lone pillars on Meep's grid", patch.alone),
    ):
        paint = partial(figures.patch_amplitude, patch.full_wave - field, *places, title=title, largest=largest)
        yield Plan(f"patch_difference_{name}", title, paint, (4.0, 3.4), PICTURE)


def _rivals(run: RunFolder) -> Iterator[Plan]:
    if run.comparison is None:
        return
    depth = partial(figures.rival_depth_errors, run.comparison)
    yield Plan("rival_depth", "Error of depth over depth, beside other cameras", depth, (4.6, 3.4))
    sharp = partial(figures.rival_sharpness, run.comparison)
    yield Plan("rival_sharpness", "Sharpness over depth, beside other cameras", sharp, (4.6, 3.4))


def _light(run: RunFolder) -> Iterator[Plan]:
    psf, ideal = run.psf, run.ideal_psf
    if psf is None:
        return
    size = (1.15 * figures.shown_depths(psf).size + 0.4, 2.66)
    yield Plan("psf_pair", "PSF pair over depth", partial(figures.pair_over_depth, psf), size, (0.3, 0.1, 0.05, 0.3))
    yield Plan("psf_orientation", "Orientation over depth", partial(figures.orientation, psf, ideal=ideal))
    peak = partial(figures.peak, psf, ideal=ideal, source=run.psf_source)
    yield Plan("psf_peak", "Peak irradiance over depth", peak)
    known = run.part("merit").get("modulation")
    if known:
        chosen = list(dict.fromkeys((0, len(known["lens"]) // 2, len(known["lens"]) - 1)))
        names = [figures.depth_text(run.part("merit")["depth_m"][d]) for d in chosen]
        pair, lens = (np.array(known[key], dtype=np.float64)[chosen] for key in ("pair_x", "lens"))
        frequency = np.array(known["frequency_per_mm"], dtype=np.float64)
        mtf = partial(figures.modulation, frequency, list(zip(names, pair, strict=True)), lens=list(lens))
        yield Plan("psf_mtf", "Modulation transfer at three depths, beside a standard lens", mtf)
    else:
        yield Plan("psf_mtf", "Modulation transfer at three depths", partial(figures.modulation, *modulation_of(psf)))
    space = run.part("merit").get("space_variance")
    if space and len(space["tangent_x"]) > 1:
        yield Plan("depth_bias", "Depth bias of both polarisations over the field", partial(figures.depth_bias, space))
        shift = partial(figures.distortion, space)
        yield Plan("distortion", "Distortion of both images over the field of view", shift)
    if psf.field is not None:
        for p in POLARISATIONS:
            paint = partial(figures.over_field, psf, polarisation=p)
            yield Plan(f"psf_field_{p}", f"PSF of {p} polarisation over the field of view", paint, (4.0, 3.6))


def _image(run: RunFolder) -> Iterator[Plan]:
    if run.raw is not None:
        yield _image_map("raw_frame", "Raw frame", partial(figures.raw_frame, run.raw), run.raw.frame.shape, 6.7)
    decoded = run.decoded
    if decoded is not None:
        image_map = partial(_image_map, shape=decoded.depth_m.shape, side_in=2.8)
        for p in POLARISATIONS:
            paint = partial(figures.intensity, decoded, polarisation=p)
            yield image_map(f"intensity_{p}", f"Decoded intensity of {p} polarisation", paint)
        yield image_map("contrast", "Polarisation contrast", partial(figures.contrast, decoded))
        yield image_map("depth", "Decoded depth", partial(figures.depth, decoded))
        yield image_map("confidence", "Confidence of the depth", partial(figures.confidence, decoded))
    known = depths_against_truth(run)
    if known is not None:
        true_m, decoded_m, error_m = known
        paint = partial(figures.depth_against_truth, true_m, decoded_m, error_m=error_m)
        yield Plan("depth_truth", "Decoded against true depth", paint, (3.6, 3.1))
