"""``phase_study.h5``: the study of a design's phases, for the report and for other tools."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
from numpy.typing import ArrayLike

from metafab.core.conventions import FloatArray
from metafab.core.storage import hdf5
from metafab.phase.optimise.rotation import MainLobe
from metafab.phase.studies.bandwidth import BandwidthBudget, BandwidthTradeoff, Remedy
from metafab.phase.studies.compare import DepthBounds
from metafab.phase.studies.study import LobeOverDepth, PhaseStudy

KIND = "metafab phase study"
FORMAT = 1


def save_study(result: PhaseStudy, path: Path, *, inputs_sha256: str) -> None:
    """Write a study to ``path``, whole or not at all; a missing part has no group."""
    with hdf5.create(path, kind=KIND, format_version=FORMAT, inputs_sha256=inputs_sha256) as file:
        if result.lobe is not None:
            _put_lobe(file.create_group("lobe"), result.lobe)
        if result.bounds is not None:
            _put_bounds(file.create_group("bounds"), result.bounds)
        if result.bandwidth is not None:
            _put_bandwidth(file.create_group("bandwidth"), result.bandwidth)


def load_study(path: Path) -> PhaseStudy:
    """Read a file of :func:`save_study`.

    Raises:
        InputError: the file is missing, truncated, foreign, or of a newer format.
    """
    remedy = "run `metafab run DESIGN.toml` again"
    with hdf5.open_kind(path, kind=KIND, format_version=FORMAT, remedy=remedy) as file:
        return PhaseStudy(
            _lobe(file["lobe"]) if "lobe" in file else None,
            _bounds(file["bounds"]) if "bounds" in file else None,
            _bandwidth(file["bandwidth"]) if "bandwidth" in file else None,
        )


def _array(group: h5py.Group, name: str) -> FloatArray:
    return np.asarray(group[name][()], dtype=np.float64)


#: Numbers of a BandwidthBudget.
_BUDGET = ("fwhm_nm", "angle_deg", "dispersion_um_per_nm", "smear_um", "kept")
#: Fields of a MainLobe: name, unit, description.
_LOBE = (
    ("defocus_rad", "rad", "rim defocus"),
    ("peak", "1", "Strehl ratio of the main lobe"),
    ("radius", "1", "distance of the main lobe from the image point, optical units"),
    ("phi_deg", "degree", "orientation of the main lobe of PSF_x, unwrapped"),
)


def _put_lobe(group: h5py.Group, lobe: LobeOverDepth) -> None:
    scale = "vergence_per_m"
    _put_scale(group, scale, lobe.vergence_per_m, "1/m", "vergence of the object from the focus")
    hdf5.put(group, "range_per_m", lobe.range_per_m, units="1/m", description="of the verified depths")
    hdf5.put(group, "law_deg", lobe.law_deg, units="degree", description="orientation by the law", dims=(scale,))
    for name, part in (("design", lobe.design), ("plain", lobe.plain)):
        for field, units, text in _LOBE:
            hdf5.put(group, f"{name}_{field}", getattr(part, field), units=units, description=text, dims=(scale,))


def _put_scale(group: h5py.Group, name: str, values: ArrayLike, units: str, description: str) -> None:
    hdf5.put(group, name, values, units=units, description=description, dims=(name,))


def _lobe(group: h5py.Group) -> LobeOverDepth:
    design, plain = (
        MainLobe(*(_array(group, f"{name}_{field}") for field, _, _ in _LOBE)) for name in ("design", "plain")
    )
    farthest, nearest = (float(value) for value in _array(group, "range_per_m"))
    return LobeOverDepth(_array(group, "vergence_per_m"), design, plain, _array(group, "law_deg"), (farthest, nearest))


def _put_bounds(group: h5py.Group, bounds: DepthBounds) -> None:
    _put_scale(group, "depth_m", bounds.depth_m, "m", "object distance")
    _put_scale(group, "mask", list(bounds.masks), "1", "name of the mask")
    for name, values, source in (
        ("point_m", bounds.point_m, "a known point source"),
        ("texture_m", bounds.texture_m, "a piece of unknown texture"),
    ):
        description = f"smallest standard deviation of depth from {source}"
        hdf5.put(group, name, values, units="m", description=description, dims=("mask", "depth_m"))


def _bounds(group: h5py.Group) -> DepthBounds:
    names = tuple(name.decode() for name in group["mask"][()])
    return DepthBounds(_array(group, "depth_m"), names, _array(group, "point_m"), _array(group, "texture_m"))


def _put_bandwidth(group: h5py.Group, budget: BandwidthBudget) -> None:
    for name in _BUDGET:
        group.attrs[name] = getattr(budget, name)
    curves = budget.tradeoff
    _put_scale(group, "fwhm_nm", curves.fwhm_nm, "nm", "width of the filter")
    _put_scale(group, "angle_deg", curves.angle_deg, "degree", "of the split")
    for name, units, description in (
        ("smear_um", "um", "spread of a point along the split"),
        ("kept", "1", "information over that of one wavelength with the same electrons"),
        ("relative_error", "1", "deviation of depth over that of one wavelength with the chosen filter's electrons"),
    ):
        values = getattr(curves, name)
        hdf5.put(group, name, values, units=units, description=description, dims=("angle_deg", "fwhm_nm"))
    azimuth, kept = budget.azimuth_deg, budget.kept_by_azimuth
    _put_scale(group, "azimuth_deg", azimuth, "degree", "direction of the split against the mask")
    text = "information kept at that direction"
    hdf5.put(group, "kept_by_azimuth", kept, units="1", description=text, dims=("azimuth_deg",))
    _put_scale(group, "remedy", np.array([r.change for r in budget.remedies], dtype="U"), "1", "what helps")
    for name, field, text in (
        ("remedy_kept", "information_kept", "information kept with it"),
        ("remedy_error", "depth_error_factor", "deviation of depth with it over without"),
    ):
        values = [getattr(remedy, field) for remedy in budget.remedies]
        hdf5.put(group, name, values, units="1", description=text, dims=("remedy",))


def _bandwidth(group: h5py.Group) -> BandwidthBudget:
    names = ("fwhm_nm", "angle_deg", "smear_um", "kept", "relative_error")
    remedies = zip(group["remedy"][()], _array(group, "remedy_kept"), _array(group, "remedy_error"), strict=True)
    return BandwidthBudget(
        **{name: float(group.attrs[name]) for name in _BUDGET},
        remedies=tuple(Remedy(change.decode(), float(kept), float(error)) for change, kept, error in remedies),
        tradeoff=BandwidthTradeoff(**{name: _array(group, name) for name in names}),
        azimuth_deg=_array(group, "azimuth_deg"),
        kept_by_azimuth=_array(group, "kept_by_azimuth"),
    )
