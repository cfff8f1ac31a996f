"""``phase.h5``: the target phases sampled over the aperture, for figures and for other tools."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from metafab.core.conventions import POLARISATIONS, FloatArray, wrap_phase
from metafab.core.storage import hdf5
from metafab.core.storage.files import fingerprint
from metafab.core.storage.tables import applicable
from metafab.phase.terms.carriers import without_carriers
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Design

KIND = "metafab phase"
FORMAT = 1


def save(profile: PhaseProfile, design: Design, path: Path | str, *, samples: int = 401) -> None:
    """Write the phases on ``samples`` x ``samples`` points of the bounding square of the aperture.

    ``/phase_rad`` is the whole phase at the points themselves. Lens and split carriers turn many times between two
    points, so ``/pupil_rad`` leaves them out: it is the part that shapes the PSF.
    """
    half_side_um = 0.5 * design.device.aperture_um
    axis_um = np.linspace(-half_side_um, half_side_um, samples)
    inside = design.device.encloses(axis_um, axis_um)
    inputs = fingerprint(design.phase, design.device, design.unit_cell.illumination, design.numerics.seed)
    with hdf5.create(path, kind=KIND, format_version=FORMAT, inputs_sha256=inputs) as file:
        hdf5.put(file, "x_um", axis_um, units="um", description="position from the axis", dims=("x_um",))
        hdf5.put(file, "y_um", axis_um, units="um", description="position from the axis", dims=("y_um",))
        hdf5.put(file, "polarisation", list(POLARISATIONS), units="1", description="x, y", dims=("polarisation",))
        for name, part, description in (
            ("phase_rad", profile, "target phase, wrapped"),
            ("pupil_rad", without_carriers(profile), "target phase without lens and split carriers, wrapped"),
        ):
            hdf5.put(
                file,
                name,
                np.where(inside, wrap_phase(part(axis_um, axis_um)), np.nan),
                units="rad",
                description=f"{description}; NaN outside the aperture",
                dims=("polarisation", "y_um", "x_um"),
                compress=True,
            )
        for name, value in applicable(profile.figures).items():
            file.attrs[name] = value


def load(path: Path | str) -> tuple[FloatArray, FloatArray]:
    """Read positions along either axis, shape (n,), um, and the pupil part of the phases, shape (2, n, n), rad.

    Phases are NaN outside the aperture. A missing, truncated or foreign file raises InputError.
    """
    remedy = "run `metafab run DESIGN.toml` again"
    with hdf5.open_kind(path, kind=KIND, format_version=FORMAT, remedy=remedy) as file:
        return np.asarray(file["x_um"][()]), np.asarray(file["pupil_rad"][()])
