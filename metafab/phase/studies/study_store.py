"""``phase_study.h5``: the study of a design's phases, for the report and for other tools."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import ArrayLike

from metafab.core.conventions import FloatArray
from metafab.core.figures import Remedy
from metafab.core.storage import hdf5
from metafab.phase.optimise.rotation import MainLobe
from metafab.phase.studies.bandwidth import BandwidthBudget, BandwidthTradeoff
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
    """Read a file of :func:`save_study`; one that is missing, truncated, foreign or newer raises InputError."""
    remedy = "run `metafab run DESIGN.toml` again"
    with hdf5.open_kind(path, kind=KIND, format_version=FORMAT, remedy=remedy) as file:
        return PhaseStudy(
            _lobe(file["lobe"]) if "lobe" in file else None,
            _bounds(file["bounds"]) if "bounds" in file else None,
            _bandwidth(file["bandwidth"]) if "bandwidth" in file else None,
        )


#: A dataset: name, values, unit, description, names of its dimensions.
_Row = tuple[str, ArrayLike, str, str, tuple[str, ...]]
#: Numbers of a BandwidthBudget, stored as attributes.
_BUDGET = ("fwhm_nm", "angle_deg", "dispersion_um_per_nm", "smear_um", "kept")
#: Fields of a MainLobe: name, unit, description.
_LOBE = (
    ("defocus_rad", "rad", "rim defocus"),
    ("peak", "1", "Strehl ratio of the main lobe"),
    ("radius", "1", "distance of the main lobe from the image point, optical units"),
    ("phi_deg", "degree", "orientation of the main lobe of PSF_x, unwrapped"),
)


def _put(group: h5py.Group, rows: Iterable[_Row]) -> None:
    for name, values, units, description, dims in rows:
        hdf5.put(group, name, values, units=units, description=description, dims=dims)


def _array(group: h5py.Group, name: str) -> FloatArray:
    return np.asarray(group[name][()], dtype=np.float64)


def _put_lobe(group: h5py.Group, lobe: LobeOverDepth) -> None:
    axis = ("vergence_per_m",)
    rows: list[_Row] = [
        ("vergence_per_m", lobe.vergence_per_m, "1/m", "vergence of the object from the focus", axis),
        ("range_per_m", lobe.range_per_m, "1/m", "vergence of the farthest and the nearest depth", ()),
        ("law_deg", lobe.law_deg, "degree", "orientation by the law", axis),
    ]
    for name, part in (("design", lobe.design), ("plain", lobe.plain)):
        rows += [(f"{name}_{field}", getattr(part, field), units, text, axis) for field, units, text in _LOBE]
    _put(group, rows)


def _lobe(group: h5py.Group) -> LobeOverDepth:
    lobes = [MainLobe(*[_array(group, f"{name}_{field}") for field, _, _ in _LOBE]) for name in ("design", "plain")]
    farthest, nearest = _array(group, "range_per_m").tolist()
    vergence, law = _array(group, "vergence_per_m"), _array(group, "law_deg")
    return LobeOverDepth(vergence, lobes[0], lobes[1], law, (farthest, nearest))


def _put_bounds(group: h5py.Group, bounds: DepthBounds) -> None:
    deviation, axes = "smallest standard deviation of depth from", ("mask", "depth_m")
    _put(
        group,
        [
            ("depth_m", bounds.depth_m, "m", "object distance", ("depth_m",)),
            ("mask", list(bounds.masks), "1", "name of the mask", ("mask",)),
            ("point_m", bounds.point_m, "m", f"{deviation} a known point source", axes),
            ("texture_m", bounds.texture_m, "m", f"{deviation} a piece of unknown texture", axes),
        ],
    )


def _bounds(group: h5py.Group) -> DepthBounds:
    names = tuple(name.decode() for name in group["mask"][()])
    return DepthBounds(_array(group, "depth_m"), names, _array(group, "point_m"), _array(group, "texture_m"))


def _put_bandwidth(group: h5py.Group, budget: BandwidthBudget) -> None:
    for name in _BUDGET:
        group.attrs[name] = getattr(budget, name)
    curves, axes, azimuth = budget.tradeoff, ("angle_deg", "fwhm_nm"), ("azimuth_deg",)
    kept = "information about depth over that at one wavelength, with equal electrons"
    error = "standard deviation of depth over that at one wavelength with the electrons of the chosen filter"
    changes = np.array([remedy.change for remedy in budget.remedies], dtype="U")
    remedy_kept = [remedy.information_kept for remedy in budget.remedies]
    remedy_error = [remedy.depth_error_factor for remedy in budget.remedies]
    deviation = "standard deviation of depth with the change, over that without it"
    _put(
        group,
        [
            ("fwhm_nm", curves.fwhm_nm, "nm", "width of the filter", ("fwhm_nm",)),
            ("angle_deg", curves.angle_deg, "degree", "angle of the split", ("angle_deg",)),
            ("smear_um", curves.smear_um, "um", "spread of a point along the split", axes),
            ("kept", curves.kept, "1", kept, axes),
            ("relative_error", curves.relative_error, "1", error, axes),
            ("azimuth_deg", budget.azimuth_deg, "degree", "direction of the split relative to the mask", azimuth),
            ("kept_by_azimuth", budget.kept_by_azimuth, "1", "information kept for that direction", azimuth),
            ("remedy", changes, "1", "change of the design", ("remedy",)),
            ("remedy_kept", remedy_kept, "1", "information kept with the change", ("remedy",)),
            ("remedy_error", remedy_error, "1", deviation, ("remedy",)),
        ],
    )


def _bandwidth(group: h5py.Group) -> BandwidthBudget:
    curves = ("fwhm_nm", "angle_deg", "smear_um", "kept", "relative_error")
    remedies = zip(group["remedy"][()], _array(group, "remedy_kept"), _array(group, "remedy_error"), strict=True)
    return BandwidthBudget(
        **{name: float(group.attrs[name]) for name in _BUDGET},
        remedies=tuple(Remedy(change.decode(), float(kept), float(error)) for change, kept, error in remedies),
        tradeoff=BandwidthTradeoff(*[_array(group, name) for name in curves]),
        azimuth_deg=_array(group, "azimuth_deg"),
        kept_by_azimuth=_array(group, "kept_by_azimuth"),
    )
