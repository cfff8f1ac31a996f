"""Far from the paper's lens: objects at infinity and at hand, steep light, apertures of a site, none, and 5 cm."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest

from benchmarks.optics.direct_sum import direct_irradiance
from metafab.core.errors import InputError
from metafab.core.parallel.work import Work
from metafab.layout.pillars import Lattice
from metafab.optics import PsfNumerics, psf, relative_l2
from metafab.optics.geometry.path import Ray, power_at_aperture
from metafab.optics.propagation.pupil import Carrier, reduce_field
from metafab.optics.sources.source import FieldTile
from tests import optics_lens as lens

OPTICS = lens.imaging(aperture_um=40.0)
SOURCE = lens.written(OPTICS, lens.eq_2(OPTICS), lens.eq_3_and_4(OPTICS))
WINDOW_PX = 16


@pytest.mark.parametrize(
    ("depth_m", "tangent"),
    [
        (0.15e-3, (0.0, 0.0)),  # nearer than the focal length
        (50.0, (0.0, 0.0)),
        (0.9e-3, (math.tan(math.radians(30.0)), 0.0)),
        (0.9e-3, (0.0, -math.tan(math.radians(30.0)))),
    ],
)
def test_near_far_and_steep_objects_keep_the_stated_error(depth_m: float, tangent: tuple[float, float]) -> None:
    """Light defocused far beyond the window, or 30 degrees off the axis: PSFs against the direct sum."""
    result = psf(SOURCE, OPTICS, [depth_m], PsfNumerics(window_px=WINDOW_PX, target_error=1e-3), tangent=tangent)
    for p in (0, 1):
        points = lens.window_points(OPTICS, result.centre_um[p, 0], WINDOW_PX)
        true = direct_irradiance(SOURCE, OPTICS, depth_m, tangent, *points, p)
        assert relative_l2(result.psf[p, 0].ravel(), true) <= result.error[0] <= 2e-3


def test_infinity_is_the_limit_of_far_objects() -> None:
    far, farther = (
        psf(SOURCE, OPTICS, [z], PsfNumerics(window_px=WINDOW_PX, target_error=1e-4)).psf for z in (1e4, math.inf)
    )
    assert relative_l2(far, farther) < 1e-5


def test_light_that_does_not_reach_the_sensor_is_refused() -> None:
    """30 degrees off the axis and split by 40 degrees the same way: beyond 90 degrees for one polarisation."""
    steep = replace(OPTICS, split_angle_deg=40.0)
    with pytest.raises(InputError, match="leaves the lens towards the sensor"):
        psf(SOURCE, steep, [0.9e-3], PsfNumerics(window_px=WINDOW_PX), tangent=(math.tan(math.radians(30.0)), 0.0))


@dataclass(frozen=True)
class _Uniform:
    """A square of any size as a stream that repeats one tile of indices."""

    aperture_um: float
    tile_sites: int = 4096
    lit: bool = True

    @property
    def lattice(self) -> Lattice:
        count = 2 * math.ceil(0.5e3 * self.aperture_um / 350.0)
        return Lattice(period_dbu=(700, 700), shape=(count, count), database_unit_nm=0.5)

    def tiles(self) -> Iterator[FieldTile]:
        count, step = self.lattice.shape[0], self.tile_sites
        index = np.zeros((step, step), dtype=np.uint16) + np.uint16(self.lit)
        table = np.array([[0.0, 0.0], [1.0, 1.0]], dtype=np.complex128)
        for row in range(0, count, step):
            for column in range(0, count, step):
                yield FieldTile(row, column, index[: count - row, : count - column], table)


@pytest.mark.parametrize("aperture_um", [8_000.0, 50_000.0])
def test_blocks_of_wide_lenses_are_right_wherever_they_lie(aperture_um: float) -> None:
    """The first row of tiles of an 8 mm and of a 5 cm lens, at the pupil: rim blocks against the exact path.

    The carrier's phase is thousands of radians there; sums of phasors in double precision hold it.
    """
    source = _Uniform(aperture_um, tile_sites=64)
    optics = replace(OPTICS, aperture_um=aperture_um, focal_length_mm=10.0 * aperture_um * 1e-3)
    optics = replace(optics, sensor_distance_um=1.05e4 * optics.focal_length_mm / 10.0)
    ray = Ray.towards_image(optics, 0, 0.3, (0.02, 0.0))
    x, y = source.lattice.x_um(), source.lattice.y_um()
    tile = next(source.tiles())

    @dataclass(frozen=True)
    class Corner:
        lattice: Lattice = source.lattice

        def tiles(self) -> Iterator[FieldTile]:
            yield tile

    (pupil,) = reduce_field(Corner(), [Carrier(0, ray, 16)], optics.wavenumber)
    phase = optics.wavenumber * ray.path_um(x[None, :64], y[:64, None])
    exact = np.exp(1j * phase).reshape(4, 16, 4, 16).sum(axis=(1, 3))
    assert np.abs(phase).max() > 1e3
    # Third-order terms and the square of the twist at f/10: 1e-6 of a block's 256 sites.
    assert np.abs(pupil.sums[0, :4, :4] - exact).max() < 256 * 1e-5
    assert pupil.power[:4, :4] == pytest.approx(256.0)


def test_a_wide_lens_is_streamed_through_whole() -> None:
    """A square of 2 mm, its 33 million sites one tile read four times: the power that passes is its area."""
    source = _Uniform(2_000.0)
    optics = replace(OPTICS, aperture_um=2_000.0, aperture_shape="square", sensor_distance_um=2e4, split_angle_deg=0.0)
    ray = Ray.towards_image(optics, 0, math.inf, (0.0, 0.0))
    (pupil,) = reduce_field(source, [Carrier(0, ray, 128)], optics.wavenumber)
    side_um = source.lattice.shape[0] * 0.35
    assert pupil.transmitted(ray) == pytest.approx(side_um**2, rel=1e-9)
    assert power_at_aperture(optics, ray) == pytest.approx(2_000.0**2, rel=1e-9)


def test_an_aperture_of_no_pillar_and_an_absorbing_library_are_dark() -> None:
    for source in (replace(SOURCE, table=0.0 * SOURCE.table), _Uniform(20.0, lit=False)):
        result = psf(source, OPTICS, [0.9e-3, math.inf], PsfNumerics(window_px=WINDOW_PX))
        assert not result.psf.any() and not result.efficiency.any()
        assert result.details.lost[0] == pytest.approx(1.0)
        assert np.isnan(result.extinction_ratio).all()


def test_any_number_of_workers_gives_the_same_bytes() -> None:
    grid = (np.array([-0.05, 0.05]), np.array([0.0, 0.04]))
    one, three = (
        psf(
            SOURCE,
            OPTICS,
            [0.8e-3, 0.9e-3],
            PsfNumerics(window_px=WINDOW_PX),
            field_tangents=grid,
            work=Work(workers=n),
        )
        for n in (1, 3)
    )
    assert one.field is not None and three.field is not None
    assert one.psf.tobytes() == three.psf.tobytes()
    assert one.field.psf.tobytes() == three.field.psf.tobytes()
    assert np.array_equal(one.extinction_ratio, three.extinction_ratio)


@dataclass(frozen=True)
class _Patches:
    """A square lens for parallel light, dark but for patches of its target phase in rows and columns over all of it."""

    aperture_um: float
    focal_um: float
    patch_sites: int = 32
    across: int = 4

    @property
    def lattice(self) -> Lattice:
        return _Uniform(self.aperture_um).lattice

    def tiles(self) -> Iterator[FieldTile]:
        x, y, wavenumber = self.lattice.x_um(), self.lattice.y_um(), OPTICS.wavenumber
        starts = np.linspace(0, x.size - self.patch_sites, self.across).astype(int).tolist()
        for row in starts:
            for column in starts:
                u = x[None, column : column + self.patch_sites]
                v = y[row : row + self.patch_sites, None]
                square = u**2 + v**2 + self.focal_um**2
                paths = [np.sqrt(square + 2.0 * sign * u * self.focal_um * lens.SINE) for sign in (1.0, -1.0)]
                yield FieldTile(row, column, amplitudes=np.exp(-1j * wavenumber * np.array(paths)))


@pytest.mark.parametrize("aperture_um", [8_000.0, 50_000.0])
@pytest.mark.parametrize("target", [3e-2, 1e-2, 1e-3])
def test_wide_lenses_from_end_to_end(aperture_um: float, target: float) -> None:
    """PSFs of 8 mm and 5 cm against the direct sum, 2 x 10^10 sites of which patches are lit.

    Light in the corners of blocks is the worst there is for their moments: an error stated from half the blocks must
    bound the true one there, too.
    """
    focal_um = 10.0 * aperture_um
    optics = lens.imaging(aperture_um=aperture_um, focal_length_mm=1e-3 * focal_um, aperture_shape="square")
    optics = replace(optics, sensor_distance_um=focal_um * math.cos(math.radians(lens.ANGLE_DEG)), pixel_um=2.0)
    source = _Patches(aperture_um, focal_um)
    result = psf(source, optics, [1e5], PsfNumerics(window_px=WINDOW_PX, target_error=target))
    for p in (0, 1):
        points = lens.window_points(optics, result.centre_um[p, 0], WINDOW_PX)
        true = direct_irradiance(source, optics, 1e5, (0.0, 0.0), *points, p)
        assert relative_l2(result.psf[p, 0].ravel(), true) <= result.error[0] <= 1.5 * target
    # The brightest point is the image point: all patches meet there in phase.
    assert np.unravel_index(result.psf[0, 0].argmax(), result.psf[0, 0].shape) == (WINDOW_PX // 2, WINDOW_PX // 2)


def test_what_would_not_fit_into_memory_is_refused_with_the_reason() -> None:
    """A window of 4 cm behind 5 cm would take blocks of a few sites, 10^9 of them."""
    optics = lens.imaging(aperture_um=50_000.0, focal_length_mm=500.0, aperture_shape="square", pixel_um=8.0)
    optics = replace(optics, sensor_distance_um=5e5)
    with pytest.raises(InputError, match="block sums suffice"):
        psf(_Patches(50_000.0, 5e5), optics, [1e3], PsfNumerics(window_px=5000, target_error=1e-4))


def test_an_object_at_5_cm_before_the_paper_lens_scaled() -> None:
    """2.5 focal lengths away and sharp 12 focal lengths behind the sensor: a blur wider than the window."""
    optics = lens.imaging(aperture_um=40.0, focal_length_mm=0.4)
    optics = replace(optics, sensor_distance_um=1.06 * 400.0 * math.cos(math.radians(lens.ANGLE_DEG)))
    source = lens.written(optics, lens.eq_2(optics), lens.eq_3_and_4(optics))
    result = psf(source, optics, [1.0e-3], PsfNumerics(window_px=32, target_error=1e-3))
    assert result.efficiency.max() < 0.9
    for p in (0, 1):
        points = lens.window_points(optics, result.centre_um[p, 0], 32)
        true = direct_irradiance(source, optics, 1.0e-3, (0.0, 0.0), *points, p)
        assert relative_l2(result.psf[p, 0].ravel(), true) <= result.error[0] <= 2e-3
