"""Error budget of a run: the measured sources of error, in the order of the pipeline."""

from __future__ import annotations

import math

from metafab.steps.layout import LayoutFigures
from metafab.steps.library import LibraryFigures
from metafab.steps.summary.run_summary import BudgetLine, RunSummary


def _errors_of_mask(library: LibraryFigures | None, layout: LayoutFigures | None) -> tuple[float | None, float | None]:
    """Library error and phase error of a mask's pillars, each in the worst light.

    The library error is that of all sizes where the layout does not state it.
    """
    largest = None if library is None or math.isnan(library.max_error) else library.max_error
    if layout is None:
        return largest, None
    lights = [light.figures for light in layout.lights or ()] or [layout]
    errors = [each.library_error for each in lights if each.library_error is not None]
    return max(errors, default=largest), max(each.phase_rms_error_rad for each in lights)


def _neighbour_lines(summary: RunSummary) -> list[BudgetLine]:
    """Error of the light of unlike neighbours: of the model if the PSFs used it, else of the approximation."""
    psf, coupling = summary.psf, summary.coupling
    if psf is not None and psf.with_neighbours and summary.library is not None:
        statistics = summary.library.neighbours
        return [
            BudgetLine(
                "model of unlike neighbours",
                None if statistics is None else statistics.error_alike,
                "relative L2",
                "field of held-out rows whose phases change steadily, by the library's model against the solver",
            ),
            BudgetLine(
                "joint effect of rows and columns",
                psf.joint_error,
                "relative L2",
                "the PSFs leave it out, and it is not solved for these pillars"
                if psf.joint_error is None
                else "left out of the PSFs: what coarse elements add to the field in up to eight windows of 3 x 3 "
                "pillars of the mask, continued periodically, cross-polarised light included; few hold most of it",
            ),
        ]
    return [
        BudgetLine(
            "local-period approximation",
            None if coupling is None else coupling.coupling_error,
            "relative L2",
            "field behind rows of one local period, full-wave, against the stitched library; `metafab coupling`"
            if coupling is None or coupling.polarised_ratio is None
            else "field behind the pillars of a repeat, full-wave, against the stitched library",
        )
    ]


def error_budget(summary: RunSummary) -> tuple[BudgetLine, ...]:
    """Collect the measured contributions to the error of the whole, in the order of the pipeline.

    Unknown errors of images are left out for a design without a scene, those of pillars for a design without a mask.
    """
    has_pillars, has_images = summary.layout is not None, summary.decode is not None
    psf = summary.psf
    pupil = BudgetLine(
        "pupil reduction and sampling",
        None if psf is None else max(psf.error),
        "relative L2",
        "PSF with blocks of half the size",
    )
    return (
        *_shown(_pillar_lines(summary), has_pillars),
        *_shown(_neighbour_lines(summary), has_pillars),
        *_shown([_oblique_line(summary)], has_pillars and has_images),
        pupil,
        *_shown(_image_lines(summary), has_images),
    )


def _shown(lines: list[BudgetLine], is_asked: bool) -> list[BudgetLine]:
    """All lines that the run is asked for; else those with a value."""
    return [line for line in lines if is_asked or line.value is not None]


def _pillar_lines(summary: RunSummary) -> list[BudgetLine]:
    """Errors of the pillars' light and of the choice of their sizes."""
    library, layout = summary.library, summary.layout
    library_error, phase_error_rad = _errors_of_mask(library, layout)
    worst = ", in the worst light" if layout is not None and layout.lights else ""
    index_error_rad = None if library is None else library.index_phase_error_rad
    is_imported = library is not None and library.is_imported
    parts = "interpolation of the sweep" if is_imported else "certificate of the truncation plus interpolation"
    unknown = "; the error of the program that solved it is not known" if is_imported else ""
    return [
        BudgetLine(
            "interpolation of the library" if is_imported else "solver and library",
            library_error,
            "complex t",
            f"rms over the pillars of the bound of each size: {parts}{worst}{unknown}",
        ),
        BudgetLine(
            "size snapping and finite library",
            phase_error_rad,
            "rad rms",
            f"phase of the chosen size against the target, over all pillars{worst}",
        ),
        BudgetLine(
            "index of the pillar",
            index_error_rad,
            "rad rms",
            "the unit cell states no standard uncertainty of it (`n_error` of `[materials] pillar`)"
            if index_error_rad is None
            else "phases solved again with the index raised by its standard uncertainty, common phase taken out",
        ),
    ]


def _oblique_line(summary: RunSummary) -> BudgetLine:
    """Error of the pillars' light from the corner of the field."""
    psf = summary.psf
    return BudgetLine(
        "oblique light",
        None if psf is None else psf.oblique_error,
        "relative L2",
        "field of sizes of the mask under light from the corner of the field, common phase taken out"
        if psf is None or psf.oblique_change is None
        else "field of held-out sizes under light from the corner of the field, by the change that the PSFs carry "
        f"({psf.oblique_change:.2g} without it)",
    )


def _image_lines(summary: RunSummary) -> list[BudgetLine]:
    """Errors of PSFs between the depths and directions of the calibration, and of the decoder."""
    psf, decode = summary.psf, summary.decode
    return [
        BudgetLine(
            "depth interpolation",
            None if psf is None else psf.depth_interpolation_error,
            "relative L2",
            "PSFs computed at the verified depths against those interpolated from the other nodes",
        ),
        BudgetLine(
            "field interpolation",
            None if psf is None else psf.field_interpolation_error,
            "relative L2",
            "PSF computed in the middle of an outermost cell of field points against the interpolated one",
        ),
        BudgetLine(
            "decoder",
            None if decode is None else decode.nmae,
            "mean |dz|/z",
            "decoded against true depth of the simulated scene",
        ),
    ]
