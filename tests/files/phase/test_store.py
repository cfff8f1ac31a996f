"""``phase.h5``: phases of the profile, with units, NaN outside the aperture."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np

from metafab import phase
from metafab.spec import Design


def test_the_pupil_part_is_the_profile_without_its_carriers(tmp_path: Path, small_design: Design) -> None:
    helix = replace(small_design.phase[0], optimise="none")
    design = replace(small_design, phase=(helix, small_design.phase[1]))
    profile = phase.profile_of(design)
    path = tmp_path / "phase.h5"
    phase.save(profile, design, path, samples=41)
    x_um, pupil_rad = phase.load(path)
    alone = phase.profile_of(replace(design, phase=(helix,)))(x_um, x_um)
    inside = np.isfinite(pupil_rad[0])
    assert inside.mean() == np.mean(np.hypot(x_um, x_um[:, None]) <= 100.0)
    for polarisation in (0, 1):
        difference = np.exp(1j * (pupil_rad[polarisation] - alone[polarisation]))[inside]
        assert np.abs(difference - 1.0).max() < 1e-12
    with h5py.File(path) as file:
        assert file["phase_rad"].dims[1]["y_um"].attrs["units"] == "um"
