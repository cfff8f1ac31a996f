"""Wide plain parts: a depth where their twins show that of their segment as a whole, and none where they show none."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metafab.camera import RawFrame, draws
from metafab.core.conventions import FloatArray
from metafab.core.numeric.distance import distance
from metafab.decode import Decoder, decode
from metafab.decode.evaluation import overlap
from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.segmentation.objects.plain_parts import rim_shows
from metafab.optics.point_spread import Psf
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf

WALL_M, SEEDS = 0.0034, (1, 2, 3)


def errors(thing: SceneObject) -> list[tuple[FloatArray, FloatArray]]:
    """Relative errors of the pixels of a wall and of a thing before it in each draw of 300 electrons; NaN for none."""
    psf, each = helix_psf(1.0 / np.linspace(1 / 0.0038, 1 / 0.0024, 13)), []
    wall = SceneObject(depth_m=WALL_M, size=(1.0, 1.0), texture_contrast=0.3)
    scene = Scene(objects=(wall, thing), photons_per_pixel=300.0, field_px=(420, 165))
    for frame in draws(scene, psf, SEEDS):
        image = decode(frame, psf)
        both = overlap(image, frame)
        assert both is not None
        here, truth = both
        error = np.abs(image.depth_m[here] / truth.depth_m - 1.0)
        each.append((error[truth.label == 1], error[truth.label == 2]))
    return each


def about_thing(frame: RawFrame, psf: Psf) -> tuple[NDArray[np.bool_], CostVolume, int]:
    """Downsampled pixels within 8 px of a thing before a wall, the frame's cost volume, and the step."""
    decoder = Decoder.of(psf, frame.frame.shape, frame.origin_um, frame.x_window)
    assert decoder is not None
    prepared, both = decoder.prepare(frame), overlap(decoder(frame), frame)
    assert not isinstance(prepared, str) and both is not None
    here, truth = both
    mask, step = np.zeros(decoder.calibration.grid.shape, dtype=bool), decoder.filters.downsampling.step
    mask[here] = truth.label == 2
    return distance(mask[::step, ::step]) * step <= 8.0, decoder.match(prepared).volume, step


def test_the_rim_of_a_plain_part_tells_a_part_of_the_wall_from_an_object_before_it() -> None:
    """The twins of an object's outline show its own depth, mixed with the wall's, at the wall's depth or another."""
    psf = helix_psf(1.0 / np.linspace(1 / 0.0038, 1 / 0.0024, 13))
    wall = SceneObject(depth_m=WALL_M, size=(1.0, 1.0), texture_contrast=0.3)
    for depth_m, of_wall in ((0.9999 * WALL_M, True), (0.0027, False)):
        thing = SceneObject(depth_m=depth_m, size=(0.14, 0.3), texture="uniform", brightness=0.7)
        scene = Scene(objects=(wall, thing), photons_per_pixel=300.0, field_px=(420, 165))
        for frame in draws(scene, psf, SEEDS):
            part, volume, step = about_thing(frame, psf)
            everywhere = np.ones_like(part)
            assert rim_shows(part, everywhere, volume, 1.0 / WALL_M, step) == of_wall
            # A part that lies about other surfaces, or with nothing about it, has no rim of its segment.
            assert not rim_shows(~part, everywhere, volume, 1.0 / WALL_M, step)
            assert not rim_shows(part, part, volume, 1.0 / WALL_M, step)


def test_a_plain_object_does_not_take_the_depth_of_the_wall_behind_it() -> None:
    """With so little light a faint texture would not show: 0.78 to 1 of its pixels had the wall's depth, 26 % off."""
    plain = SceneObject(depth_m=0.0027, size=(0.2, 0.3), texture="uniform")
    before_wall = errors(plain)
    for wall, thing in before_wall:
        assert np.isfinite(thing).mean() < 0.1  # measured: none
        # 0.83 to 0.86: windows that hold the outline show nothing clear.
        assert np.isfinite(wall).mean() > 0.75
    assert np.median([np.nanmedian(wall) for wall, _ in before_wall]) < 0.01  # 0.002 to 0.011
    enclosed = SceneObject(depth_m=0.0027, size=(0.14, 0.3), texture="uniform", brightness=0.7)
    # Measured: 0.004 to 0.03; 0.98 in one of three draws with another kernel of BLAS, as a whole by chance.
    assert np.median([np.isfinite(thing).mean() for _, thing in errors(enclosed)]) < 0.1


def test_a_part_of_the_wall_with_a_faint_texture_keeps_its_depth() -> None:
    """Noise outweighs its texture in most windows, but not in all of them together."""
    faint = SceneObject(depth_m=0.9999 * WALL_M, size=(0.2, 0.3), texture_contrast=0.06)
    shares = []
    for _, thing in errors(faint):
        shares.append(np.isfinite(thing).mean())
        assert np.nanmedian(thing) < 0.015
    # Measured: 0.96 to 0.995; by the plain pixels alone, without the specks among them, one of three had no depth.
    assert np.median(shares) > 0.9 and np.mean(shares) > 0.6
