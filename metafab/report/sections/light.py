"""PSF pair over depth and field, figures of merit, and the effect of fabrication errors."""

from __future__ import annotations

import math
from html import escape

from metafab.core.conventions import POLARISATIONS
from metafab.core.figures import AberrationFigures, FocusFigures
from metafab.report import html
from metafab.report.html import Drawn
from metafab.report.run_folder import RunFolder
from metafab.report.style import depth_text
from metafab.spec.light import light_label
from metafab.steps.layout import LayoutFigures
from metafab.steps.optics.lights import LightsFigures
from metafab.steps.optics.merit import MeritFigures

#: Source of the simulated light, by whether the design has a mask.
_SOURCE = {True: "the pillars in the written file", False: "the target phases themselves: this design writes no mask"}

#: Names of Noll's polynomials from number 2.
_NOLL = (
    "tilt along x", "tilt along y", "defocus", "astigmatism at 45°", "astigmatism at 0°", "coma along y",
    "coma along x", "trefoil at 30°", "trefoil at 0°", "spherical aberration",
)  # fmt: skip
#: First word of a corner's name: text for readers, and unit.
_CORNERS = {
    "cd_bias_nm": ("CD bias", " nm"),
    "height_nm": ("height", " nm"),
    "sidewall_angle_deg": ("sidewall", "°"),
    "pillar_n_shift": ("pillar index", ""),
}


def point_spread(run: RunFolder, drawn: Drawn) -> str:
    """PSF pair over depth, live and as figures, and figures of merit."""
    if run.psf is None:
        return html.section("psf", "Point-spread functions", html.note(run.notes.get("psf", "no PSF")))
    several = run.psf.depth_m.size > 1
    text = f"Simulated from {_SOURCE[run.outline.has_mask]}{_illumination(run, run.psf.depth_m.tolist())}. "
    text += "The crosshairs mark the geometric image point"
    text += "; the arrows point from it to the maximum." if run.has_lobe else "."
    lacks_ideal = run.ideal_psf is None and run.outline.has_mask
    return html.section(
        "psf",
        "Point-spread functions",
        html.paragraph(text),
        *(html.note(text) for each in (run.summary.psf, run.summary.lights) if each for text in each.warnings()),
        _viewer(several),
        html.wide(html.figure(drawn["psf_pair"])) if "psf_pair" in drawn else "",
        html.figures(drawn, *(("psf_orientation", "psf_peak") if several else ()), "psf_focus", "psf_mtf"),
        "" if run.summary.merit is None else _merit(run.summary.merit, run),
        "" if run.summary.lights is None else _lights(run.summary.lights, run.summary.layout),
        html.figures(drawn, "wavefront_x", "wavefront_y"),
        html.figures(drawn, "psf_field_x", "psf_field_y"),
        html.figures(drawn, "depth_bias", "distortion"),
        html.note(run.notes.get("ideal_psf", "no PSF of the target phases")) if lacks_ideal else "",
    )


def _illumination(run: RunFolder, depth_m: list[float]) -> str:
    """Words for the light of the PSFs, if the design has several, and for the depth, if it has one."""
    several = f", at {run.outline.own_light}" if run.outline.own_light else ""
    if len(depth_m) > 1:
        return several
    is_parallel = run.outline.is_parallel(*depth_m)
    return several + (", in parallel light" if is_parallel else f", of objects {depth_text(*depth_m)} away")


def _viewer(several: bool) -> str:
    """Live view of the pair, with a slider where there are several depths."""
    still = "" if several else " hidden"
    return (
        '<div class="viewer" id="psf-viewer" hidden>'
        '<div class="pair">'
        '<figure><canvas data-pol="0" role="img" aria-label="PSF of x polarisation"></canvas>'
        '<figcaption class="x">x polarisation</figcaption></figure>'
        '<figure><canvas data-pol="1" role="img" aria-label="PSF of y polarisation"></canvas>'
        '<figcaption class="y">y polarisation</figcaption></figure></div>'
        f'<div class="controls"><label{still}>Object depth <output class="depth"></output>'
        '<input type="range" min="0" step="1" value="0"></label>'
        '<div class="choice" role="group" aria-label="Source of the PSFs"></div>'
        f'<button type="button" class="play" aria-pressed="false"{still}>Play</button></div>'
        '<p class="readout" aria-live="polite"></p></div>'
    )


def _focus(focus: FocusFigures) -> str:
    """Figures of a lens' focus beside those of the ideal flat lens."""
    (x_x, x_y), (y_x, y_y) = focus.fwhm_polarised_um
    (x_x_limit, x_y_limit), (y_x_limit, y_y_limit) = focus.fwhm_polarised_limit_um
    rows = [
        ["FWHM along x / µm", html.number(focus.fwhm_x_um), html.number(focus.fwhm_limit_um)],
        ["FWHM along y / µm", html.number(focus.fwhm_y_um), html.number(focus.fwhm_limit_um)],
        ["x polarised: along x, y / µm", _both(x_x, x_y), _both(x_x_limit, x_y_limit)],
        ["y polarised: along x, y / µm", _both(y_x, y_y), _both(y_x_limit, y_y_limit)],
        ["Strehl ratio", _share(focus.strehl), "1"],
        [
            f"encircled energy within {html.number(focus.encircled_radius_um)} µm",
            _share(focus.encircled_energy),
            _share(focus.encircled_energy_limit),
        ],
    ]
    text = (
        f"Focus at NA {focus.numerical_aperture:.3g}, beside the ideal flat lens of the aperture. Widths: of the "
        "electric energy density, in unpolarised light unless named. Strehl ratio, encircled energy: per transmitted "
        "power; the circle has the radius of a round lens' first dark ring."
    )
    return html.table(["", "written mask", "limit"], rows, ["", "n", "n"]) + html.paragraph(text, "caption")


def _lights(figures: LightsFigures, layout: LayoutFigures | None) -> str:
    """Efficiency, focus and library error in each light that the mask serves; no focus for light at an angle."""
    mapped = {
        light_label(each.wavelength_nm, each.angle_x_deg, each.angle_y_deg): each.figures
        for each in (layout and layout.lights) or ()
    }
    rows = [
        [
            light.label,
            _share(mapped[light.label].efficiency if light.label in mapped else math.nan),
            _share(0.5 * sum(pair[0] for pair in (light.pair.efficiency_x, light.pair.efficiency_y))),
            _share(0.5 * (light.ideal_efficiency_x[0] + light.ideal_efficiency_y[0])),
            *(
                ["–", "–", "–"]
                if light.focus is None
                else [
                    html.number(0.5 * (light.focus.fwhm_x_um + light.focus.fwhm_y_um)),
                    html.number(light.focus.fwhm_limit_um),
                    _share(light.focus.strehl),
                ]
            ),
            html.number(mapped[light.label].library_error if light.label in mapped else None, 2),
        ]
        for light in figures.lights
    ]
    head = ["light", "wanted wave", "window", "of the target phases", "FWHM / µm", "limit / µm", "Strehl ratio"]
    head.append("library error")
    text = (
        "Wavelengths and directions that the mask serves, at the first depth, mean of both polarisations. Shares "
        "of the light at the aperture: in the wanted wave by the mapping, in the window, and there by the target "
        "phases. Library error: bound on complex t, rms over the pillars. "
        "Widths and Strehl ratios are those of a lens' light along the axis."
    )
    return html.table(head, rows, ["", *["n"] * (len(head) - 1)]) + html.paragraph(text, "caption")


def _both(first: float, second: float) -> str:
    return f"{html.number(first)}, {html.number(second)}"


def _aberrations(fronts: tuple[AberrationFigures, ...]) -> str:
    """Wavefront of a lens: rms and the first Zernike coefficients of each polarisation."""
    rows = [
        ["rms", *(_waves(front.rms_waves) for front in fronts)],
        *(
            [f"{number}, {name}", *(_waves(front.noll_waves[number - 1]) for front in fronts)]
            for number, name in enumerate(_NOLL, start=2)
        ),
        ["what 36 polynomials leave", *(_waves(front.residual_waves) for front in fronts)],
        ["Strehl ratio of the phase", *(_share(front.strehl_of_phase) for front in fronts)],
    ]
    text = (
        "Wavefront error about the sphere to the image point, in waves, positive where light arrives late. Numbers and "
        "norm are Noll's: rms over the aperture; merit.json holds 36 of them and of the fringe set. Rms and "
        "Strehl ratio leave out tilt, which moves the image and does not blur it."
    )
    head = ["Zernike polynomial", *(f"{front.polarisation} polarised" for front in fronts)]
    return html.table(head, rows, ["", *["n"] * len(fronts)]) + html.paragraph(text, "caption")


def _merit(merit: MeritFigures, run: RunFolder) -> str:
    """Figures of merit over depth, and measured values of the fabricated device."""
    has_lobe, forms_images = run.has_lobe, run.forms_images
    focus = "" if merit.focus is None else _focus(merit.focus)
    focus += "" if merit.aberrations is None else _aberrations(merit.aberrations)
    if merit.focus is not None and len(merit.depth_m) == 1:
        return focus + _measured(merit)
    peaks = (merit.relative_peak_x, merit.relative_peak_y)
    columns: dict[str, list[str]] = {}
    if len(merit.depth_m) > 1:
        columns["depth"] = [escape(depth_text(depth)) for depth in merit.depth_m]
    if forms_images:
        columns["efficiency x"] = [_share(share) for share in merit.pinhole_efficiency_x]
        columns["efficiency y"] = [_share(share) for share in merit.pinhole_efficiency_y]
    for p, peak in zip(POLARISATIONS, peaks, strict=True):
        columns[f"peak {p}"] = [_share(each) for each in peak or [math.nan] * len(merit.depth_m)]
    if not all(map(math.isnan, merit.extinction_ratio)):
        columns["extinction"] = [_ratio(ratio) for ratio in merit.extinction_ratio]
    if has_lobe:
        lobes = [[html.number(size) for size in lobe] for lobe in merit.main_lobe_x_um]
        columns["lobe x / µm"], columns["lobe y / µm"] = map(list, zip(*lobes, strict=True))
    head, rows = list(columns), [list(row) for row in zip(*columns.values(), strict=True)]
    text = "Peak: relative to the target phases."
    if forms_images:
        pinhole = f"a pinhole of {merit.pinhole_um:.3g} µm"
        text = f"Efficiency: share of the light at the aperture that passes {pinhole}. {text}"
    if has_lobe:
        text += " Lobe: position of the main lobe of PSF_x, from the image point."
    if has_lobe and len(rows) > 1:
        # Adding zero removes the minus sign of -0.0.
        pair, ideal = (round(angle, 1) + 0.0 for angle in (merit.rotation_deg, merit.ideal_rotation_deg))
        text += f" The pair rotates by {pair:.1f}°, the target phases by {ideal:.1f}°."
    return focus + html.table(head, rows, ["n"] * len(head)) + html.paragraph(text, "caption") + _measured(merit)


def _measured(merit: MeritFigures) -> str:
    measured, chain = merit.measured, merit.loss_chain
    if measured is None:
        return ""
    extinction = merit.extinction_ratio[merit.depth_m.index(chain.depth_m)]
    values = [
        ("efficiency x", chain.efficiency[0], measured.efficiency_x),
        ("efficiency y", chain.efficiency[1], measured.efficiency_y),
        ("extinction ratio", extinction, measured.extinction_ratio),
    ]
    rows = [
        [name, html.number(simulated), html.number(value)] for name, simulated, value in values if value is not None
    ]
    source = html.paragraph(escape(measured.source), "caption")
    return html.table(["", "simulated", "measured"], rows, ["", "n", "n"]) + source


def tolerances(run: RunFolder) -> str:
    """Effect of fabrication errors; empty where it was not computed."""
    figures = run.summary.tolerance
    if figures is None:
        return ""
    nearest_m = min(figures.depth_m)
    columns: dict[str, list[str]] = {
        "PSF": [html.number(row.change, 2) for row in figures.rows],
        "peak": [_share(row.peak_ratio) for row in figures.rows],
        "efficiency": [_share(row.efficiency) for row in figures.rows],
        "extinction": [_ratio(row.extinction_ratio) for row in figures.rows],
        "rotation / °": [html.number(row.turn_deg, 2) for row in figures.rows],
        "depth error / %": [html.number(100.0 * row.depth_error_m / nearest_m, 2) for row in figures.rows],
        "FWHM along x / µm": [html.number(row.fwhm_x_um, 4) for row in figures.rows],
        "along y / µm": [html.number(row.fwhm_y_um, 4) for row in figures.rows],
        "Strehl ratio": [_share(row.strehl) for row in figures.rows],
    }
    # A lens has no extinction, rotation and depth, another device no focus.
    columns = {head: cells for head, cells in columns.items() if set(cells) != {html.number(math.nan)}}
    columns["± of the change"] = [
        "below error" if row.below_error else f"{html.number(100.0 * row.relative_error, 2)}\u202f%"
        for row in figures.rows
    ]
    rows = [
        [escape(_corner(row.corner)), *cells]
        for row, cells in zip(figures.rows, zip(*columns.values(), strict=True), strict=True)
    ]
    head = ["corner", *columns]
    text = (
        "The worst of both polarisations and all depths. For random faults: rms over draws, but the mean for "
        "efficiency, peak, extinction and focus. PSF: relative L2 change; below error: no larger than the error of the "
        "PSFs. "
    )
    if "depth error / %" in columns:
        text += "Depth error: of a decoder calibrated with the nominal mask, relative to the nearest depth. "
    if "Strehl ratio" in columns:
        nominal = figures.nominal
        widths_um = " and ".join(html.number(width_um, 4) for width_um in (nominal.fwhm_x_um, nominal.fwhm_y_um))
        text += f"Without faults the focus is {widths_um} µm wide, with a Strehl ratio of {_share(nominal.strehl)}. "
    text += "The pillars of the mask stay; only their amplitudes change."
    return html.section(
        "tolerance",
        "Effect of fabrication errors",
        html.table(head, rows, ["", *["n"] * (len(head) - 1)]),
        html.paragraph(text, "caption"),
    )


def _corner(name: str) -> str:
    """Name of a corner for readers: ``cd_bias_nm -10`` becomes CD bias −10 nm."""
    key, _, value = name.partition(" ")
    if key not in _CORNERS:
        return name.replace("_", " ")
    text, unit = _CORNERS[key]
    return f"{text} {value.replace('-', '−')}{unit}"


def _waves(value: float) -> str:
    """A wavefront error with four decimals; adding zero removes the minus sign of -0.0."""
    return f"{round(value, 4) + 0.0:.4f}".replace("-", "−")


def _share(value: float) -> str:
    """A share with three decimals, so that figures align in a column."""
    return f"{value:.3f}" if math.isfinite(value) else html.number(value)


def _ratio(value: float) -> str:
    """A ratio with three digits; a large one as a whole number."""
    return html.number(round(value) if math.isfinite(value) and value >= 100.0 else value)
