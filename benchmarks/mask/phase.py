"""Benchmark of the phase design: results of the optimisers, their distance from the bound, and the time of the tiles.

``error`` is the missing share of the proven bound for the peak, the rms relative error of depth for the far lens, and
the largest difference from the plain formulas in rad for the tiles. The searches for information and with limited side
lobes have no bound (NaN).
"""

from __future__ import annotations

import math
import resource
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.mask.twin_images import most_likely_defocus, twin_images
from metafab.information.texture import Texture
from metafab.phase import PhaseProfile, Pupil, SplitLensPhase, limit_side_lobes, optimise_blind, optimise_peak, propose
from metafab.phase.optimise.blind import BlindInformation
from metafab.phase.pupil import pupil_field, rim_defocus_per_dioptre_rad, rim_defocus_rad
from metafab.phase.terms.helices import spiral_field

TILE_SITES, PERIOD_UM, SITES = 286, 0.35, 25.6e6


def rows(quick: bool) -> list[dict[str, Any]]:
    """Rows of all optimisers and numbers of zones, of the far lens, and of all tiles of a 2 mm lens."""
    optimise_peak(2)  # warm-up
    table = [_peak(zones, goal) for zones in ((4,) if quick else (2, 3, 4, 5, 7)) for goal in ("mean", "worst")]
    table += [_blind(zones) for zones in ((4,) if quick else (2, 4, 7))]
    table += [_side_lobes(limit) for limit in ((0.3,) if quick else (0.35, 0.3, 0.25))]
    return [*table, _far(4 if quick else 16), _tiles()]


def _timed(call: Callable[[], Any]) -> tuple[Any, float]:
    start = time.perf_counter()
    result = call()
    return result, time.perf_counter() - start


def _row(name: str, error: float, seconds: float, **more: float) -> dict[str, Any]:
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return {"name": name, "error": error, "seconds": seconds, "peak_rss_mb": peak_mb, **more}


def _peak(zones: int, goal: Any) -> dict[str, Any]:
    design, seconds = _timed(lambda: optimise_peak(zones, goal=goal))
    gains = {"mean_gain": design.peak_gain, "worst_gain": design.worst_gain}
    return _row(f"peak, {goal}, L = {zones}", 1.0 - design.bound_fraction, seconds, **gains)


def _blind(zones: int) -> dict[str, Any]:
    pupil = Pupil(64)
    defocus = rim_defocus_rad(1.0 / np.linspace(4.0, 1.0 / 0.6, 10), 0.30, 1000.0, 0.8)
    problem = BlindInformation(pupil, defocus, Texture())
    start = pupil_field(optimise_peak(zones).term(1.0), pupil, 1.0)
    design, seconds = _timed(lambda: optimise_blind(problem, start, iterations=20))
    plain = problem.of_field(spiral_field(pupil, zones, 0.5))
    gain = float(design.information.mean() / plain.mean())
    return _row(f"blind information, L = {zones}", math.nan, seconds, information_gain=gain)


def _side_lobes(limit: float) -> dict[str, Any]:
    start = optimise_peak(4)
    design, seconds = _timed(lambda: limit_side_lobes(start, limit))
    gains = {
        "mean_gain": design.peak_gain,
        "side_lobe": design.limited,
        "side_lobe_without_limit": design.limited_at_start,
    }
    return _row(f"side lobes below {limit:g}, L = 4", math.nan, seconds, **gains)


def _far(draws: int) -> dict[str, Any]:
    """An aperture of 5 cm at 200 m: depth by maximum likelihood on simulated twin images, and its bound."""
    best = propose(150.0, 250.0, aperture_um=5e4, wavelength_um=0.8)[0]
    pupil, random = Pupil(48), np.random.default_rng(1)
    mask, focus_m = spiral_field(pupil, best.zones, best.exponent), best.focus_depth_m
    problem = BlindInformation(pupil, rim_defocus_rad([200.0], focus_m, 25_000.0, 0.8), Texture())
    true, (nearest, farthest) = float(problem.defocus_rad[0]), rim_defocus_rad([140.0, 270.0], focus_m, 25_000.0, 0.8)
    per_metre = rim_defocus_per_dioptre_rad(25_000.0, 0.8) / 200.0**2

    def estimate() -> list[float]:
        images = (twin_images(problem, mask, true, random) for _ in range(draws))
        return [most_likely_defocus(pair, problem, mask, nearest, farthest) for pair in images]

    estimates, seconds = _timed(estimate)
    error = float(np.sqrt(np.mean((np.array(estimates) - true) ** 2))) / per_metre / 200.0
    bound = 1.0 / (math.sqrt(float(problem.of_field(mask)[0])) * per_metre * 200.0)
    return _row("depth at 200 m, aperture 5 cm", error, seconds / draws, bound=bound)


def _tiles() -> dict[str, Any]:
    """All sites of the 2 mm lens, both polarisations, one thread; extrapolated from twenty tiles."""
    helix = optimise_peak(4).term(1000.0)
    profile = PhaseProfile((helix, SplitLensPhase(wavelength_um=0.8, image_distance_um=20000.0, angle_deg=8.0)))
    x_um = (np.arange(TILE_SITES) + 400.0) * PERIOD_UM
    y_um = (np.arange(TILE_SITES) - 900.0) * PERIOD_UM
    phase = profile(x_um, y_um)
    x, y = x_um[None, :], y_um[:, None]
    plain = -2.0 * np.pi / 0.8 * (np.sqrt(x**2 + y**2 + 4e8 + 4e4 * x * np.sin(np.radians(8.0))) - 2e4)
    plain += np.angle(helix.field(x_um / 1000.0, y_um / 1000.0))
    error = float(np.abs(np.exp(1j * (phase[0] - plain)) - 1.0).max())
    _, seconds = _timed(lambda: [profile(x_um, y_um) for _ in range(20)])
    return _row("25.6 million sites, both polarisations", error, seconds / 20 * SITES / TILE_SITES**2)
