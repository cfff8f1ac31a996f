"""The hologram of a design's picture, sampled at the sites of the lattice."""

from __future__ import annotations

import math

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.errors import Fault, InputError
from metafab.core.figures import PhaseFigures
from metafab.core.parallel.progress import Progress
from metafab.core.storage.pictures import read_grey
from metafab.phase.formulas import conjugates_um
from metafab.phase.pupil import Pupil
from metafab.phase.terms.hologram import ImagePlane, design_hologram
from metafab.phase.terms.profile import Term
from metafab.phase.terms.sampled import SampledPhase
from metafab.spec import terms as spec
from metafab.spec.design import Design


def require_paintable(design: Design) -> None:
    """Raise InputError for pictures that cannot be read, are dark, or reach farther than the lattice can send light."""
    faults = []
    for number, term in enumerate(design.phase):
        if isinstance(term, spec.Picture):
            name = f"phase[{number}]"
            try:
                rows, columns = _picture(term).shape
            except InputError as error:
                faults += [Fault(f"{name}.file", f.expected, f.got, f.remedy) for f in error.faults]
                continue
            widest_um = _image_plane(design).widest_um((rows, columns))
            if term.width_um > widest_um:
                expected = f"at most {widest_um:.6g} um (wavelength times distance over period, along x and y)"
                faults.append(Fault(f"{name}.width_um", expected, f"{term.width_um:g} um", "narrow the picture"))
    if faults:
        raise InputError(design.name, faults)


def hologram_of(design: Design, term: spec.Picture, progress: Progress) -> tuple[Term, PhaseFigures]:
    """Return the hologram of a picture and its figures; InputError as :func:`require_paintable`."""
    require_paintable(design)
    plane = _image_plane(design)
    sites = Pupil(int(design.device.aperture_um / plane.pitch_um + 1e-9), design.device.aperture_shape)
    hologram = design_hologram(_picture(term), term.width_um, plane, inside=sites.inside, progress=progress)
    field = np.stack([hologram.field, hologram.field])
    figures = PhaseFigures(hologram_efficiency=hologram.efficiency, hologram_correlation=hologram.correlation)
    return SampledPhase(field, plane.pitch_um, polarisation=term.polarisation), figures


def _picture(term: spec.Picture) -> FloatArray:
    picture = read_grey(term.file)
    if not np.isfinite(picture).all() or picture.min() < 0.0 or picture.max() == 0.0:
        least, most = float(picture.min()), float(picture.max())
        got = f"{least:g} to {most:g}" if math.isfinite(least + most) else "NaN or infinity"
        raise InputError.single(str(term.file), "values", "finite, none below zero, and some above", got)
    return picture


def _image_plane(design: Design) -> ImagePlane:
    pitch_um = 1e-3 * min(design.unit_cell.cell.period_nm)
    distance_um = conjugates_um(design, design.sensor.focus_depth_m)[0]
    return ImagePlane(pitch_um=pitch_um, wavelength_um=design.wavelength_um, distance_um=distance_um)
