"""``phase.h5``: the target phases sampled over the aperture, for looking at and for other tools."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from metafab.core.conventions import POLARISATIONS, FloatArray, wrap_phase
from metafab.core.storage import hdf5
from metafab.core.storage.files import fingerprint
from metafab.phase.terms.carriers import CARRIERS
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Design
from metafab.spec.outline import encloses

KIND = "metafab phase"
FORMAT = 1
_SAMPLES = 401


def save(profile: PhaseProfile, design: Design, path: Path, *, samples: int = _SAMPLES) -> None:
    """Write the phases on ``samples`` x ``samples`` points of the aperture's bounding square.

    Lens and split carriers turn many times between two such points, so they are left out of ``/pupil_rad``, the
    part that is a design choice; ``/phase_rad`` is the whole phase at the points themselves.
    """
    half_side_um = 0.5 * design.device.aperture_um
    axis_um = np.linspace(-half_side_um, half_side_um, samples)
    pupil = PhaseProfile(tuple(term for term in profile.terms if not isinstance(term, CARRIERS)), {})
    inputs = fingerprint(design.phase, design.device, design.unit_cell.illumination, design.numerics.seed)
    with hdf5.create(path, kind=KIND, format_version=FORMAT, inputs_sha256=inputs) as file:
        hdf5.put(file, "x_um", axis_um, units="um", description="position from the axis", dims=("x_um",))
        hdf5.put(file, "y_um", axis_um, units="um", description="position from the axis", dims=("y_um",))
        hdf5.put(file, "polarisation", list(POLARISATIONS), units="1", description="x, y", dims=("polarisation",))
        for name, what, description in (
            ("phase_rad", profile, "target phase, wrapped"),
            ("pupil_rad", pupil, "target phase without lens and split carriers, wrapped"),
        ):
            hdf5.put(
                file,
                name,
                _inside(design, axis_um, wrap_phase(what(axis_um, axis_um))),
                units="rad",
                description=f"{description}; NaN outside the aperture",
                dims=("polarisation", "y_um", "x_um"),
                compress=True,
            )
        for name, value in profile.figures.items():
            file.attrs[name] = value


def load(path: Path) -> tuple[FloatArray, FloatArray]:
    """Positions (n,) in um and the pupil part of the target phases (2, n, n) in rad from ``phase.h5``.

    Raises:
        InputError: the file is missing, truncated or foreign.
    """
    remedy = "run `metafab run DESIGN.toml` again"
    with hdf5.open_kind(path, kind=KIND, format_version=FORMAT, remedy=remedy) as file:
        return np.asarray(file["x_um"][()]), np.asarray(file["pupil_rad"][()])


def _inside(design: Design, axis_um: FloatArray, phase_rad: FloatArray) -> FloatArray:
    phase_rad[:, ~encloses(design.device, axis_um, axis_um)] = np.nan
    return phase_rad
