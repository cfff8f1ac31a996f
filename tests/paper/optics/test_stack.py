"""Fig. 2g and h of Shen 2023 on the target phases: a conjugate pair that turns one way over the depth range."""

from __future__ import annotations

import numpy as np
import pytest

from metafab import phase
from metafab.layout.pillars import Lattice
from metafab.optics import Imaging, Psf, PsfNumerics, depth_nodes, ideal_field, psf, relative_l2
from metafab.spec import load_design
from tests.main_job import ROOT

#: Sampling of the target phases: a phase is a function, so a coarse lattice serves where Eq. 3 stays well sampled.
PERIOD_NM = {"helix_small": 350.0, "helix_2mm": 1750.0}


def _stack(name: str) -> Psf:
    design = load_design(ROOT / "layouts" / f"{name}.toml")
    imaging = Imaging.of(design)
    period = round(2 * PERIOD_NM[name])
    count = int(design.device.aperture_um * 2e3 // period)
    source = ideal_field(
        phase.profile_of(design),
        Lattice(period_dbu=(period, period), shape=(count, count), database_unit_nm=0.5),
        design.device,
    )
    depths = depth_nodes(imaging, design.verify.depths_m[0], design.verify.depths_m[-1], 1e-3)
    return psf(source, imaging, depths, PsfNumerics(window_px=65))


@pytest.fixture(scope="module", params=["helix_small", "helix_2mm"])
def stack(request: pytest.FixtureRequest) -> Psf:
    return _stack(request.param)


def test_the_pair_is_conjugate_about_the_geometric_image_points(stack: Psf) -> None:
    for index in range(stack.depth_m.size):
        mirrored = stack.psf[0, index, ::-1, ::-1]
        assert relative_l2(stack.psf[1, index], mirrored) < 2.0 * stack.error[index]


def test_the_rotation_is_monotonic_over_the_design_depths(stack: Psf) -> None:
    """-225 / L degrees a dioptre for the 2 mm lens, L = 4: 60 degrees from 25 to 34 cm; the small lens the same."""
    turn = np.unwrap(stack.phi_deg, period=360.0)
    assert np.all(np.diff(turn) > 0.0)
    dioptres = 1.0 / 0.25 - 1.0 / 0.34
    assert turn[-1] - turn[0] == pytest.approx(225.0 / 4.0 * dioptres, rel=0.15)


def test_the_lobe_stays_one_and_bright(stack: Psf) -> None:
    """Main lobe's peak over the depth range: the shape is almost invariant (Fig. 2h)."""
    peaks = stack.psf[0].max(axis=(1, 2))
    assert peaks.min() > 0.5 * peaks.max()
