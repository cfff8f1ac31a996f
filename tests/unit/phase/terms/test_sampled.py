"""Phases given by samples, and files of a user's own."""

from __future__ import annotations

import math
from pathlib import Path

import h5py
import numpy as np
import pytest

from metafab.core.conventions import wrap_phase
from metafab.core.errors import InputError
from metafab.phase import (
    load_array,
)

X_UM = np.linspace(-90.0, 80.0, 23)
Y_UM = np.linspace(-70.0, 95.0, 17)
RADIUS_UM = 100.0
ANGLE_RAD = 1e-11  # stated error of the compiled arctangent


def test_samples_are_met_exactly_and_jumps_of_two_pi_are_none(tmp_path: Path) -> None:
    positions = (np.arange(81) - 40.0) * 5.0
    smooth = 0.13 * positions[None, :] + 0.07 * positions[:, None]  # many turns, 0.65 rad a sample
    np.save(tmp_path / "wrapped.npy", wrap_phase(smooth))
    term = load_array(tmp_path / "wrapped.npy", 5.0, "phase_rad", RADIUS_UM)
    np.testing.assert_allclose(wrap_phase(term(positions, positions, "x") - smooth), 0.0, atol=ANGLE_RAD)
    between = term(X_UM, Y_UM, "y")
    expected = 0.13 * X_UM[None, :] + 0.07 * Y_UM[:, None]
    # Of a linear phase, the angle of the mean of two phasors 0.65 rad apart errs by at most theta^3 / 72 sqrt(3).
    np.testing.assert_allclose(wrap_phase(between - expected), 0.0, atol=2 * 0.65**3 / (72 * math.sqrt(3)) * 1.2)


def test_arrays_are_read_from_all_three_kinds_of_file(tmp_path: Path) -> None:
    phase = np.arange(12.0).reshape(3, 4) / 7.0
    np.save(tmp_path / "a.npy", phase)
    np.savetxt(tmp_path / "a.csv", phase, delimiter=",", fmt="%.17g")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["mine"] = np.stack([phase, -phase])
    x_um, y_um = np.array([-3.0, -1.0, 1.0, 3.0]), np.array([-2.0, 0.0, 2.0])
    for name in ("a.npy", "a.csv", "a.h5"):
        term = load_array(tmp_path / name, 2.0, "mine", 3.0)
        np.testing.assert_allclose(term(x_um, y_um, "x"), phase, atol=ANGLE_RAD)
        sign = -1.0 if name == "a.h5" else 1.0
        np.testing.assert_allclose(term(x_um, y_um, "y"), sign * phase, atol=ANGLE_RAD)


def test_degrees_and_levels_of_pictures_are_no_radians(tmp_path: Path) -> None:
    slope = np.linspace(-30.0, 30.0, 64)
    phase = -0.02 * (slope[None, :] ** 2 + slope[:, None] ** 2)  # 1.1 rad a sample at most
    wrapped = wrap_phase(phase)
    # Zeros around an aperture, and a steep edge all around: 2 of 64 steps.
    masked = np.where(slope[None, :] ** 2 + slope[:, None] ** 2 < 900.0, phase, 0.0)
    for name, values in (("unwrapped", phase), ("wrapped", wrapped), ("masked", masked)):
        np.save(tmp_path / f"{name}.npy", values)
        load_array(tmp_path / f"{name}.npy", 1.0, "phase_rad", 30.0)
    for name, values in (("degrees", np.degrees(wrapped)), ("levels", np.uint8(np.mod(phase / np.pi, 2.0) * 127.9))):
        np.save(tmp_path / f"{name}.npy", values)
        with pytest.raises(InputError, match=rf"`{name}.npy`: expected radians.*convert degrees, or levels"):
            load_array(tmp_path / f"{name}.npy", 1.0, "phase_rad", 30.0)


def test_two_levels_in_degrees_or_of_a_picture_are_no_radians(tmp_path: Path) -> None:
    """Of wide bars few steps are steep, but all that there are."""
    bars = np.broadcast_to(np.arange(64) // 16 % 2, (64, 64))
    for name, values in (("radians", np.pi * bars), ("turns", 20.0 * bars), ("even", np.full((64, 64), 90.0))):
        np.save(tmp_path / f"{name}.npy", values)
        load_array(tmp_path / f"{name}.npy", 1.0, "phase_rad", 30.0)
    for name, values in (("degrees", 180.0 * bars), ("levels", np.uint8(255 * bars))):
        np.save(tmp_path / f"{name}.npy", values)
        with pytest.raises(InputError, match=rf"`{name}.npy`: expected radians"):
            load_array(tmp_path / f"{name}.npy", 1.0, "phase_rad", 30.0)


def test_a_pitch_of_which_less_than_two_samples_lie_across_the_aperture_is_refused(tmp_path: Path) -> None:
    """500 nm given as micrometres: one sample over the whole lens."""
    np.save(tmp_path / "map.npy", np.zeros((80, 80)))
    load_array(tmp_path / "map.npy", 0.5, "phase_rad", 20.0)
    load_array(tmp_path / "map.npy", 20.0, "phase_rad", 20.0)
    with pytest.raises(InputError, match=r"`pitch_um`: expected a pitch of at most 20 um.*got 500 um; is it in micro"):
        load_array(tmp_path / "map.npy", 500.0, "phase_rad", 20.0)


def test_arrays_that_cannot_be_used_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "small.npy", np.zeros((4, 4)))
    np.save(tmp_path / "hole.npy", np.full((4, 4), np.nan))
    np.save(tmp_path / "flat.npy", np.zeros(4))
    np.save(tmp_path / "complex.npy", np.ones((4, 4), dtype=complex))
    (tmp_path / "broken.h5").write_bytes(b"not HDF5")
    (tmp_path / "phase.txt").write_text("0")
    with pytest.raises(InputError, match="cover the aperture"):
        load_array(tmp_path / "small.npy", 1.0, "phase_rad", 10.0)
    for name in ("hole.npy", "flat.npy", "complex.npy"):
        with pytest.raises(InputError, match="finite real numbers"):
            load_array(tmp_path / name, 10.0, "phase_rad", 10.0)
    with pytest.raises(InputError, match="got NaN or infinity at 16 of 16 places"):
        load_array(tmp_path / "hole.npy", 10.0, "phase_rad", 10.0)
    for name in ("broken.h5", "phase.txt", "missing.csv"):
        with pytest.raises(InputError, match=r"\.npy, \.csv or \.h5"):
            load_array(tmp_path / name, 10.0, "phase_rad", 10.0)
