"""What phases are worth: bounds of several masks against the optics room's own, the filter's budget, the lobe."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.core.conventions import sensor_distance_um
from metafab.information.psf_stacks import depth_crlb_m, point_information, twin_depth_information
from metafab.information.texture import PointSource, Texture
from metafab.phase import Pupil, bandwidth_budget, compare_masks, profile_of, study
from metafab.phase.pupil import FocalPlane, rim_defocus_rad
from metafab.phase.studies.bandwidth import SplitImaging
from metafab.phase.studies.compare import reference_masks
from metafab.phase.studies.study import mask_field
from metafab.phase.terms.helices import spiral_field
from metafab.spec import Design
from metafab.spec.design import Optics
from metafab.spec.terms import SpiralZones

PUPIL = Pupil(32)
DEPTH_M = 1.0 / np.linspace(4.0, 3.0, 13)
SETTING = {"focus_depth_m": 0.28, "aperture_um": 2000.0, "wavelength_um": 0.8}
NOISE = {"source": PointSource(), "texture": Texture()}


def _plain(design: Design) -> Design:
    spiral = design.phase[0]
    assert isinstance(spiral, SpiralZones)
    return replace(design, phase=(replace(spiral, optimise="none"), *design.phase[1:]))


def test_bounds_at_the_pupil_are_those_of_a_sampled_stack() -> None:
    """The same masks through the matrix Fourier transform, splined over depth: another code from mask to bound."""
    masks = reference_masks(PUPIL, 4, 0.5)
    bounds = compare_masks(masks, PUPIL, DEPTH_M, **SETTING, **NOISE)  # type: ignore[arg-type]
    assert bounds.masks == ("standard lens", "plain spiral", "double helix")
    # Nyquist steps of pi / 2 in a window of 64, as the pupil's own transform has them; sums of PSFs are 1.
    axis = (np.arange(64) - 32) * np.pi / 2.0
    defocus = rim_defocus_rad(DEPTH_M, 0.28, 1000.0, 0.8)
    for row, field in enumerate(masks.values()):
        stack = np.empty((2, DEPTH_M.size, 64, 64))
        kernel = np.exp(-1j * np.outer(axis, PUPIL.axis))
        for polarisation in (0, 1):
            for column, w in enumerate(defocus):
                grid = np.zeros((32, 32), dtype=complex)
                grid[PUPIL.inside] = field[polarisation] * np.exp(1j * w * PUPIL.radius_squared)
                amplitude = kernel @ grid @ kernel.T
                stack[polarisation, column] = np.abs(amplitude) ** 2 / (64**2 * PUPIL.count)
        point = depth_crlb_m(point_information(stack, DEPTH_M, 1.0, PointSource()))
        inner = slice(2, -2)  # splines are weak at their ends
        if row:  # at focus the lens has next to nothing, which a spline cannot follow
            np.testing.assert_allclose(bounds.point_m[row, inner], point[inner], rtol=5e-3)
        if np.isfinite(bounds.texture_m[row]).all():
            texture = depth_crlb_m(twin_depth_information(stack, DEPTH_M, 1.0, Texture()))
            np.testing.assert_allclose(bounds.texture_m[row, inner], texture[inner], rtol=5e-3)


def test_only_the_single_helix_reads_unknown_texture_and_everybody_a_point() -> None:
    bounds = compare_masks(reference_masks(PUPIL, 4, 0.5), PUPIL, DEPTH_M, **SETTING, **NOISE)  # type: ignore[arg-type]
    told = np.isfinite(bounds.texture_m)
    assert told[1].all() and not told[0].any() and not told[2].any()
    assert np.isfinite(bounds.point_m[1:]).all()


def test_bounds_fall_with_light_and_grow_with_noise() -> None:
    def bound(**change: float) -> np.ndarray:
        source, texture = replace(PointSource(), **change), replace(Texture(), **change)
        masks = {"spiral": reference_masks(PUPIL, 4, 0.5)["plain spiral"]}
        found = compare_masks(masks, PUPIL, DEPTH_M[:3], **SETTING, source=source, texture=texture)
        return np.stack([found.point_m, found.texture_m])

    assert (bound(electrons=1e5) < bound(electrons=1e4)).all()
    assert (bound(read_noise_e=20.0) > bound(read_noise_e=2.0)).all()
    # Without any other noise, photons alone: a hundred times the light, a tenth of the deviation.
    dark = {"background_e": 0.0, "read_noise_e": 0.0}
    ratio = bound(electrons=1e6, **dark)[0] / bound(electrons=1e4, **dark)[0]
    np.testing.assert_allclose(ratio, 0.1, rtol=1e-9)


def test_pixels_without_light_and_noise_do_no_harm() -> None:
    """A clear aperture of Nyquist samples has exact zeros; without any noise they are 0 / 0."""
    quiet = {"source": PointSource(100.0, 0.0, 0.0), "texture": Texture(read_noise_e=0.0)}
    found = compare_masks(reference_masks(PUPIL, 4, 0.5), PUPIL, DEPTH_M, **SETTING, **quiet)  # type: ignore[arg-type]
    assert not np.isnan(found.point_m).any()


@pytest.fixture(scope="module")
def imaging() -> SplitImaging:
    defocus = rim_defocus_rad(1.0 / np.linspace(4.0, 1.0 / 0.34, 3), 0.30, 1000.0, 0.8)
    distance_um = sensor_distance_um(20.0, 8.0, 0.30)
    return SplitImaging(PUPIL, spiral_field(PUPIL, 4, 0.5), defocus, 2000.0, 20.0, distance_um, 0.8, Texture(), 4.0)


def test_the_budget_of_the_papers_lens(imaging: SplitImaging) -> None:
    budget = bandwidth_budget(imaging, 8.0)
    assert budget.dispersion_um_per_nm == pytest.approx(3.8, rel=0.01)
    assert budget.smear_um == pytest.approx(4.0 * budget.dispersion_um_per_nm, rel=1e-9)
    assert 0.0 < budget.kept < 1.0
    # The design's own azimuth is the first, and its own cell of the curves.
    assert budget.kept_by_azimuth[0] == pytest.approx(budget.kept, rel=1e-9)
    errors = [remedy.relative_error for remedy in budget.remedies]
    assert errors == sorted(errors) and all(error < 1.0 for error in errors)
    assert any(remedy.change == "a split of 2 degrees" for remedy in budget.remedies)
    for remedy in budget.remedies:
        # At the same electrons the deviation goes with one over the root of the information.
        if not remedy.change.startswith("a filter"):
            assert remedy.relative_error == pytest.approx((budget.kept / remedy.kept) ** 0.5, rel=1e-9)


def test_turning_mask_and_split_together_changes_nothing(imaging: SplitImaging) -> None:
    """Only the direction of the split against the mask counts: a mask turned by 90 degrees, exact on a square grid."""
    grid = np.zeros(PUPIL.inside.shape, dtype=complex)
    grid[PUPIL.inside] = imaging.mask
    turned = replace(imaging, mask=np.rot90(grid, -1)[PUPIL.inside])  # rows are y upwards: counter-clockwise
    before = imaging.filtered(4.0, [(8.0, 0.0), (8.0, 30.0)])
    after = turned.filtered(4.0, [(8.0, 90.0), (8.0, 120.0)])
    np.testing.assert_allclose(after, before, rtol=1e-6)  # one-sided Nyquist frequency of an even grid


def test_a_study_has_what_the_design_declares(small_design: Design) -> None:
    design = _plain(small_design)
    profile = profile_of(design)
    without = study(design, profile)
    assert without.bandwidth is None and without.lobe is not None and without.bounds is not None
    assert without.bounds.masks[0] == "this design"
    np.testing.assert_array_equal(without.bounds.texture_m[0], without.bounds.texture_m[2])  # it is the plain spiral
    np.testing.assert_array_equal(without.lobe.design.peak, without.lobe.plain.peak)
    assert without.bounds.depth_m[0] == pytest.approx(design.depths_m[0])
    assert without.bounds.depth_m[-1] == pytest.approx(design.depths_m[-1])
    budget = study(replace(design, optics=Optics(10.0)), profile).bandwidth
    assert budget is not None and budget.fwhm_nm == 10.0


def test_a_design_without_helix_or_split_has_no_lobe_and_no_budget(small_design: Design) -> None:
    split = small_design.phase[1]
    lens = replace(small_design, phase=(split,), optics=Optics(10.0))
    found = study(lens, profile_of(lens))
    assert found.lobe is None and found.bounds is not None and found.bandwidth is not None
    assert not np.isfinite(found.bounds.texture_m[0]).any(), "a lens tells nothing"
    helix = replace(_plain(small_design), optics=Optics(10.0))
    helix = replace(helix, phase=helix.phase[:1])
    assert study(helix, profile_of(helix)).bandwidth is None, "nothing is split"


def test_masks_leave_the_carriers_out(small_design: Design) -> None:
    design = _plain(small_design)
    field = mask_field(profile_of(design), PUPIL, 0.5 * design.device.aperture_um)
    np.testing.assert_allclose(field[0], spiral_field(PUPIL, 4, 0.5), atol=1e-12)
    grid = np.zeros((2, *PUPIL.inside.shape), dtype=complex)
    grid[:, PUPIL.inside] = field
    np.testing.assert_allclose(grid[1], grid[0, ::-1, ::-1], atol=1e-12)
    assert FocalPlane(PUPIL, 3.0).psf(field[0], [0.0]).max() <= 1.0
