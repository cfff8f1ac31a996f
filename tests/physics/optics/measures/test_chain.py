"""The loss chain: what structured errors take and leave unseen, and factors that multiply to what passes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from metafab import layout, optics, phase
from metafab.core.figures import Wavefront
from metafab.layout.pillars import PillarMap
from metafab.library.library import Library
from metafab.optics import Psf, PsfNumerics, WrittenField, psf, relative_l2
from metafab.optics.measures import metrics
from metafab.optics.measures.chain import loss_chain, wavefront
from metafab.spec import Design
from tests import optics_lens as lens

OPTICS = lens.imaging(aperture_um=120.0, focal_length_mm=0.6)
DEPTH_M = 1.8e-3
SOURCE = lens.written(OPTICS, lens.eq_2(OPTICS), lens.eq_3_and_4(OPTICS), levels=24)


def _with_error(rms_rad: float) -> WrittenField:
    """The library's phases wrong by a smooth function of the phase itself, as a wrong height or index would do."""
    phase_rad = np.angle(SOURCE.table[1:])
    error_rad = math.sqrt(2.0) * rms_rad * np.cos(2.0 * phase_rad)
    table = SOURCE.table.copy()
    table[1:] *= np.exp(1j * error_rad)
    return replace(SOURCE, table=table)


def _shape(stack: Psf) -> np.ndarray:
    return np.asarray(stack.psf / stack.psf.sum(axis=(2, 3), keepdims=True))


def test_the_shape_of_a_psf_does_not_validate_a_library() -> None:
    """0.25 rad rms: |<exp(i e)>|^2 = J_0(0.35)^2 = 0.94 of the efficiency is left; the shape hardly changes.

    No error of 0.25 rad rms takes more than 0.25^2 of it (|<exp(i e)>|^2 >= 1 - <e^2>): a mask that should reach 0.82
    reaches 0.77. The light that is missing stands in the stray orders, whose growth tells what the shape hides.
    """
    right, wrong = (psf(s, OPTICS, [DEPTH_M], PsfNumerics(target_error=1e-4)) for s in (SOURCE, _with_error(0.25)))
    ratio = wrong.efficiency / right.efficiency
    bessel = 1.0 - 0.25**2 + 0.25**4 * 0.375  # J_0(x)^2 to fourth order in x = 0.25 sqrt(2)
    assert ratio == pytest.approx(bessel, abs=2e-3)
    shape_change = relative_l2(_shape(wrong), _shape(right))
    assert shape_change < 4e-3
    assert np.all(np.abs(ratio - 1.0) > 10.0 * shape_change)
    for before, after in zip(right.details.stray, wrong.details.stray, strict=True):
        gained = after - before
        assert gained == pytest.approx(float(right.efficiency[0, 0] * (1.0 - bessel)), rel=0.05)


def test_factors_multiply_to_what_passes() -> None:
    front = Wavefront((0.95, 0.96), (0.0, 0.0), (0.98, 0.97), 0.99, 100)
    passed = np.array([0.70, 0.72])
    losses = loss_chain(front, np.array([0.9, 0.88]), passed, np.array([0.93, 0.94]), coupling=(0.97, 0.97))
    assert np.prod([loss.factor for loss in losses if loss.factor], axis=0) == pytest.approx(0.97 * passed)
    stopped = loss_chain(front, np.array([0.9, 0.88]), passed, np.array([0.93, 0.94]), stopped=np.array([0.95, 0.95]))
    assert np.prod([loss.factor for loss in stopped if loss.factor], axis=0) == pytest.approx(passed)
    # The same device without the stop: all else is as it was.
    bare = loss_chain(front, np.array([0.9, 0.88]) / 0.95, passed / 0.95, np.array([0.93, 0.94]) / 0.95)
    assert [loss.factor for loss in stopped[1:]] == [loss.factor for loss in bare]
    unmeasured = loss_chain(front, np.array([0.9, 0.88]), passed, np.array([0.93, 0.94]))
    assert [loss.factor is None for loss in unmeasured] == [False, False, False, False, True, False, False]
    assert np.prod([loss.factor for loss in unmeasured if loss.factor], axis=0) == pytest.approx(passed)


def test_the_chain_of_a_deflector_ends_with_the_target_wave_and_a_holograms_with_its_frame() -> None:
    front = Wavefront((0.95, 0.96), (0.0, 0.0), (0.98, 0.97), 0.99, 100)
    transmitted, passed = np.array([0.9, 0.88]), np.array([0.70, 0.72])
    deflector = loss_chain(front, transmitted)
    wanted = transmitted * front.overlap * 0.99
    assert np.prod([loss.factor for loss in deflector if loss.factor], axis=0) == pytest.approx(wanted)
    assert not any("pinhole" in loss.stage for loss in deflector)
    hologram = loss_chain(front, transmitted, passed, np.array([0.93, 0.94]), opening="frame of the picture")
    assert [loss.stage for loss in hologram[-2:]] == [
        "target phases through the frame of the picture",
        "stray light into the frame of the picture",
    ]


def test_the_chain_of_a_mapped_lens_closes(smooth_library: Library, small_design: Design) -> None:
    """Little of the light that is in no wanted wave falls into the pinhole: the last factor is nearly 1."""
    device = replace(small_design.device, aperture_um=70.0, focal_length_mm=0.35)
    design = replace(small_design, device=device, sensor=replace(small_design.sensor, focus_depth_m=0.00105))
    profile, imaging = phase.profile_of(design), optics.Imaging.of(design)
    pillars: PillarMap = layout.assign(profile, smooth_library, design).pillars
    written = optics.written_field(pillars, smooth_library)
    ideal = optics.ideal_field(profile, layout.lattice_of(design), device)
    stacks = [psf(source, imaging, [0.00105]) for source in (written, ideal)]
    front = wavefront(written, profile, device, smooth_library)
    assert front.sites == np.count_nonzero(pillars.to_array())
    assert front.filled == pytest.approx(front.sites / (0.25 * math.pi * (70.0 / 0.35) ** 2), abs=2e-3)
    assert all(0.9 < overlap < 1.0 for overlap in front.overlap)
    assert all(best >= own - 1e-3 for best, own in zip(front.best_overlap, front.overlap, strict=True))
    transmitted = np.array(stacks[0].details.transmitted)
    passed, ideally = (metrics.pinhole_efficiency(stack)[:, 0] for stack in stacks)
    losses = loss_chain(front, transmitted, passed, ideally)
    assert np.prod([loss.factor for loss in losses if loss.factor], axis=0) == pytest.approx(passed)
    assert losses[-1].factor == pytest.approx((1.0, 1.0), abs=0.02)


def test_a_mask_of_the_target_phases_themselves_loses_nothing_to_the_wavefront(smooth_library: Library) -> None:
    exact = lens.ideal(OPTICS, lens.eq_3_and_4(OPTICS))

    class Exact:
        lattice = exact.lattice
        tiles = exact.tiles
        pillars = PillarMap(exact.lattice, np.array([(0, 0), (200, 200), (500, 500)], dtype=np.int32), iter, 1)

    front = wavefront(Exact(), exact.profile, exact.device, smooth_library)  # type: ignore[arg-type]
    assert front.overlap == pytest.approx((1.0, 1.0), abs=1e-12)
    assert all(best < 1.0 for best in front.best_overlap)
