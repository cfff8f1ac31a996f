"""Work that the steps of a run left out, with the measured error of leaving it out."""

from __future__ import annotations

import math
from collections.abc import Iterator

from metafab.spec import Design
from metafab.steps.images import DecodeFigures
from metafab.steps.layout import LayoutFigures
from metafab.steps.library import LibraryFigures
from metafab.steps.optics import PsfFigures
from metafab.steps.summary.run_summary import RunSummary, Saving


def savings(design: Design, summary: RunSummary) -> tuple[Saving, ...]:
    """Collect the work that the steps left out, in the order of the pipeline, from the figures of a run."""
    library, layout, psf, decode = summary.library, summary.layout, summary.psf, summary.decode
    found: list[Saving] = []
    if library is not None:
        found += _of_library(library)
    if psf is not None:
        found += [*_of_psf(design, psf, layout), *_of_angles(design, psf, library)]
    if decode is not None:
        found += _of_decode(decode)
    return tuple(found)


def _of_library(library: LibraryFigures) -> Iterator[Saving]:
    solved, total = library.points_solved, library.points_total
    if not 0 < solved < total:
        return
    why = "mirror images about the diagonal exchange x and y polarisation"
    if not library.max_model_error > 0.0:  # NaN without a model
        yield Saving("library", "unit cells", solved, total, why)
        return
    why += ", and a rational model gives the other sizes; it was tested at sizes that it was not fitted to"
    yield Saving("library", "unit cells", solved, total, why, library.max_model_error, "complex t, bound")


def _of_psf(design: Design, psf: PsfFigures, layout: LayoutFigures | None) -> Iterator[Saving]:
    if layout is not None and psf.blocks is not None and psf.blocks < layout.pillars:
        yield Saving(
            "psf",
            "places on the lens",
            round(psf.blocks),
            layout.pillars,
            "the path over a block of sites is expanded to second order",
            max(psf.error),
            "relative L2",
        )
    if design.scene is None:
        return
    yield Saving(
        "psf",
        "depths",
        psf.depths,
        None,
        "PSFs are interpolated between depths, which stand densely enough for the target error",
        psf.depth_interpolation_error,
        "relative L2",
    )
    directions = math.prod(design.verify.field_points)
    yield Saving(
        "psf",
        "directions of the field",
        directions,
        math.prod(design.scene.field_px),
        "one direction serves all" if directions == 1 else "PSFs are interpolated between the directions",
        psf.field_interpolation_error,
        "relative L2",
    )


def _of_angles(design: Design, psf: PsfFigures, library: LibraryFigures | None) -> Iterator[Saving]:
    """Light at angles that the PSFs over the field leave out."""
    if psf.oblique_error is None or psf.oblique_change is not None:
        return
    statistics = None if library is None or not psf.with_neighbours else library.neighbours
    if design.optics is not None and design.optics.oblique is False:
        why = "`optics.oblique` is false"
    elif design.light:
        why = "not available with several `light`"
    elif statistics is None:
        why = (
            "unlike neighbours, which the library does not know, change the field as well; `optics.oblique` asks for it"
        )
    else:
        why = f"the model of unlike neighbours errs by more, {statistics.error_alike:.2g}"
    yield Saving("psf", "angles of the light on pillars", 1, None, why, psf.oblique_error, "relative L2 of the field")


def _of_decode(decode: DecodeFigures) -> Iterator[Saving]:
    if decode.pixels is None:
        return
    dark = (decode.pixels_without_signal or 0) + (decode.pixels_broken or 0)
    if dark:
        why = "pixels without light, saturated ones and those that are no number hold no depth"
        yield Saving("decode", "pixels", decode.pixels - dark, decode.pixels, why)
    if decode.step_px is not None and decode.step_px > 1:
        yield Saving(
            "decode",
            "compared pixels",
            math.ceil(decode.pixels / decode.step_px**2),
            decode.pixels,
            "the compared pixels keep 90 % of the Fisher information about depth, or more",
        )
