"""PSFs of full-Stokes lenses: where each state goes, conjugate pairs, and power on any lattice."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from metafab.core.polarisation import JONES, ORTHOGONAL, stokes_of, stokes_response
from metafab.layout import lattice_of
from metafab.layout.turned import assign_turned
from metafab.library.library import Library
from metafab.library.use.amplitudes import turned_jones
from metafab.optics import Apodisation, Imaging, apodised, ideal_field, written_field
from metafab.optics.polarisation_states import StokesPsf, stokes_psf
from metafab.phase.jones_target import JonesTarget, nearest_unitary
from metafab.spec import Design
from tests.stokes_lens import ROW_ANGLE_DEG, hexagonal_lens, perfect_psf, quarter_lens


@pytest.fixture(scope="module")
def psf() -> StokesPsf:
    return perfect_psf(quarter_lens(), [0.003], window_px=64)


def expected_shares() -> tuple[np.ndarray, np.ndarray]:
    """What each place takes of its own and of the orthogonal state if the six phases were independent, by drawing them.

    The coefficient of one of the waves in what perfect pillars send is the mean of their matrices against it.
    """
    waves = np.exp(2j * np.pi * np.random.default_rng(0).random((6, 100_000)))
    states = JONES.conj()
    entries = np.stack([states[:, 0] ** 2, states[:, 0] * states[:, 1], states[:, 1] ** 2])
    sent = nearest_unitary(entries @ waves)
    responses = [stokes_response(xx, xy, xy, yy) for xx, xy, yy in (sent @ waves.conj().T / waves.shape[1]).T]
    lights = stokes_of(JONES)
    own = np.einsum("kj,kj->k", responses, lights)
    return own, np.einsum("kj,kj->k", responses, lights[list(ORTHOGONAL)])


def test_each_place_takes_its_own_state_and_leaves_the_orthogonal_one(psf: StokesPsf) -> None:
    should, should_not = expected_shares()
    # Twice the ninth that three kinds of pillars side by side could send, and nothing of the orthogonal state.
    assert should == pytest.approx(0.27, abs=0.01)
    assert should_not.max() < 1e-4
    window_px = psf.psf.shape[-1]
    wide = perfect_psf(quarter_lens(), [0.003], window_px=2 * window_px)
    other = psf.efficiency / psf.extinction_ratio
    # A quarter of the aperture spreads its light four times as wide: windows reach to where the next place's begin, and
    # six phases over some thousand pillars are not quite independent.
    assert wide.efficiency.mean() == pytest.approx(should.mean(), rel=0.1)
    # All that goes to no place, spread evenly over the six places' cells alone, would put this much into each window;
    # it goes to further orders, too.
    stray = 1.0 - 0.5 * should.sum()
    places = np.unique(np.round(psf.centre_um), axis=0)
    across, rise = np.ptp(places[:, 0]), np.ptp(places[:, 1]) / 2.0
    most = stray * (window_px * psf.pixel_um) ** 2 / (6.0 * across * rise)
    assert other.mean() < most
    # What leaves cannot be more than what came.
    assert psf.instrument[:, 0].sum() < 1.0


def test_the_pairs_are_conjugate() -> None:
    """What the first state of a pair shows at r, the second shows at -r, cross-talk of the sum aside."""
    psf = perfect_psf(quarter_lens(), [0.0025, 0.0028, 0.0031, 0.0034], window_px=32)
    for first, second in ((0, 1), (2, 3), (4, 5)):
        a, b = (psf.psf[k, 0, 0] / psf.psf[k, 0, 0].sum() for k in (first, second))
        mirrored = np.roll(b[::-1, ::-1], (1, 1), axis=(0, 1))
        alike, unlike = (np.sum(a * c) / np.sqrt(np.sum(a * a) * np.sum(c * c)) for c in (mirrored, b))
        assert alike > 0.8
        assert alike > unlike + 0.1


def test_a_quarter_of_a_turn_exchanges_the_axes() -> None:
    a_x, a_y = 0.8 + 0.1j, 0.2 - 0.7j
    assert turned_jones(np.array([a_x, a_y]), np.array(90.0)) == pytest.approx(np.array([a_y, 0.0, a_x]), abs=1e-12)


def test_a_hexagonal_lattice_sends_the_same_shares(psf: StokesPsf) -> None:
    """Perfect pillars send the same light from any lattice that samples the phases: cells cover the plane once."""
    hexagonal = perfect_psf(hexagonal_lens(), [0.003], window_px=64)
    assert hexagonal.efficiency == pytest.approx(psf.efficiency, rel=0.02)


def test_a_stop_takes_its_share_of_the_light() -> None:
    """A stop of 0.8 of the diameter passes 0.64 of the power; all of the remaining light still goes to the places."""
    design = quarter_lens()
    target, imaging = JonesTarget.of(design, ROW_ANGLE_DEG), Imaging.of(design)
    whole = ideal_field(target, lattice_of(design), design.device)
    stopped = apodised(whole, Apodisation(stop_um=0.8 * design.device.aperture_um))
    wide, narrow = (stokes_psf(source, target, imaging, [0.003], window_px=128) for source in (whole, stopped))
    # The smaller aperture spreads its images wider than the window by some per cent.
    assert narrow.efficiency.sum() == pytest.approx(0.64 * wide.efficiency.sum(), rel=0.05)


@pytest.mark.parametrize("lens", [quarter_lens, hexagonal_lens])
def test_written_pillars_transmit_no_more_than_the_library(lens: Callable[[], Design], smooth_library: Library) -> None:
    """Of light that comes through the aperture, windows hold at most the pillars' largest transmittance."""
    design = lens()
    design = dataclasses.replace(design, device=dataclasses.replace(design.device, aperture_um=30.0))
    target = JonesTarget.of(design, ROW_ANGLE_DEG)
    library = dataclasses.replace(smooth_library, unit_cell=design.unit_cell)
    pillars = assign_turned(target, library, design, angles=8, size_step_nm=16.0).pillars
    source = written_field(pillars, library)
    psf = stokes_psf(source, target, Imaging.of(design), [0.003], window_px=64)
    largest = float(np.sum(np.abs(source.table) ** 2 * [1.0, 2.0, 1.0], axis=1).max()) / 2.0
    # The efficiency of perfect pillars, 0.27, times the overlap of real ones, about 0.7, bounds it from below.
    assert 0.08 < psf.efficiency.mean() < 0.27 * largest
