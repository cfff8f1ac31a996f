"""The low-rank basis: every PSF to the error asked, no image more than that takes, and weights as smooth as PSFs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.optics.psf_basis import PsfBasis
from metafab.core.errors import InputError
from metafab.optics import Psf, PsfNumerics, at_depths, at_tangent, psf, relative_l2
from metafab.optics.geometry.imaging import depth_nodes
from tests import optics_lens as lens

OPTICS = lens.imaging(aperture_um=40.0)
TANGENTS = (np.linspace(-0.06, 0.06, 5), np.linspace(-0.04, 0.04, 3))


@pytest.fixture(scope="module")
def stack() -> Psf:
    source = lens.written(OPTICS, lens.eq_2(OPTICS), lens.eq_3_and_4(OPTICS))
    nodes = depth_nodes(OPTICS, 0.7e-3, 1.1e-3, 1e-2)
    return psf(source, OPTICS, nodes, PsfNumerics(window_px=24, target_error=1e-2), field_tangents=TANGENTS)


@pytest.mark.parametrize("target", [1e-1, 1e-2, 1e-3])
def test_every_psf_is_carried_to_the_target(stack: Psf, target: float) -> None:
    basis = PsfBasis.of(stack, target)
    assert stack.field is not None
    carried = np.einsum("pdyxr,prij->pdyxij", basis.weights, basis.images)
    errors = [relative_l2(carried[at], stack.field.psf[at]) for at in np.ndindex(stack.field.psf.shape[:4])]
    # Single precision rounds each at some 1e-7.
    assert max(errors) <= basis.error + 1e-6 <= target + 2e-6
    fewer = np.einsum("pdyxr,prij->pdyxij", basis.weights[..., :-1], basis.images[:, :-1])
    worst = max(relative_l2(fewer[at], stack.field.psf[at]) for at in np.ndindex(stack.field.psf.shape[:4]))
    assert worst > target


def test_images_are_orthonormal_and_fewer_than_the_psfs(stack: Psf) -> None:
    basis = PsfBasis.of(stack, 1e-2)
    for images in basis.images.reshape(2, basis.rank, -1):
        assert images @ images.T == pytest.approx(np.eye(basis.rank), abs=1e-5)
    assert stack.field is not None
    assert basis.rank < np.prod(stack.field.psf.shape[1:4])
    assert basis.nbytes < stack.field.psf.nbytes


def test_between_nodes_it_is_the_interpolation_of_the_stack(stack: Psf) -> None:
    """Splines are linear: mixing images by splined weights is splining the images."""
    basis = PsfBasis.of(stack, 1e-4)
    tangent, depth = (0.025, -0.013), 0.83e-3
    over_depth = replace(stack, psf=at_tangent(stack, tangent), field=None)
    assert relative_l2(basis.psf_at(depth, tangent), at_depths(over_depth, [depth])[:, 0]) < 1e-3


def test_weights_of_many_points_at_once(stack: Psf) -> None:
    basis = PsfBasis.of(stack, 1e-2)
    depth, x, y = np.full((2, 3), 0.9e-3), np.linspace(-0.05, 0.05, 6).reshape(2, 3), np.zeros((2, 3))
    weights = basis.weights_at(depth, x, y)
    assert weights.shape == (2, 2, 3, basis.rank)
    assert weights[:, 1, 2] == pytest.approx(basis.weights_at(0.9e-3, 0.05, 0.0))


def test_a_stack_on_the_axis_is_a_field_of_one(stack: Psf) -> None:
    basis = PsfBasis.of(replace(stack, field=None), 1e-3)
    assert basis.tangent_x.size == basis.tangent_y.size == 1
    assert relative_l2(basis.psf_at(float(stack.depth_m[2])), stack.psf[:, 2]) < 2e-3


def test_nothing_is_extrapolated(stack: Psf) -> None:
    basis = PsfBasis.of(stack)
    for name, point in (
        ("depth_m", (2e-3, 0.0, 0.0)),
        ("tangent_x", (0.9e-3, 0.1, 0.0)),
        ("tangent_y", (0.9e-3, 0.0, 0.1)),
    ):
        with pytest.raises(InputError, match=name):
            basis.weights_at(*point)


def test_dark_psfs_have_a_dark_basis(stack: Psf) -> None:
    dark = replace(stack, psf=0.0 * stack.psf, field=None)
    basis = PsfBasis.of(dark)
    assert basis.error == 0.0 and not basis.psf_at(0.9e-3).any()
