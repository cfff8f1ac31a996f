"""A design compared with other cameras, from its phases to ``comparison.json``."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from metafab import comparison
from metafab.core.errors import InputError
from metafab.spec import Design, Optics
from metafab.spec.terms import Lens


@pytest.fixture(scope="module")
def design(small_design: Design) -> Design:
    """Half the small lens, its helix not optimised: quick."""
    device = dataclasses.replace(small_design.device, aperture_um=100.0)
    terms = tuple(dataclasses.replace(t, optimise="none") if hasattr(t, "optimise") else t for t in small_design.phase)
    verify = dataclasses.replace(small_design.verify, depths_m=(0.0014, 0.0048), window_px=48)
    return dataclasses.replace(small_design, device=device, phase=terms, verify=verify)


def test_a_helix_pair_measures_depth_where_a_lens_in_focus_does_not(design: Design, tmp_path: Path) -> None:
    result = comparison.compare(design, planes=2)
    assert result.error.shape == result.bound.shape == (5, result.depth_m.size)
    helix, lens = result.error[0], result.error[result.methods.index("standard lens")]
    # On both sides of its focus a lens looks the same: some depth is taken for its twin.
    assert lens.max() > 3.0 * helix.max()
    assert helix.max() < 0.1
    by_name = dict(zip(result.cameras, result.restored, strict=True))
    # A helix stays as sharp over the range; a lens that is focused at its end does not.
    assert np.ptp(by_name["this design"]) < 0.5 * np.ptp(by_name["lens, focused nearer"])
    assert by_name["standard lens"].min() < by_name["this design"].min()
    comparison.save_comparison(result, tmp_path / "comparison.json")
    back = comparison.load_comparison(tmp_path / "comparison.json")
    assert back is not None
    assert back.methods == result.methods
    np.testing.assert_allclose(back.error, result.error, rtol=1e-12)
    (tmp_path / "comparison.json").write_text("{}")
    assert comparison.load_comparison(tmp_path / "comparison.json") is None


def test_stop_and_filter_of_the_design_count(design: Design) -> None:
    """A stop of half the aperture doubles the width of the standard lens's focus; a wide filter smears it."""
    depth_m = np.array([0.0029, 0.0031])
    plain, *others = (
        comparison.rivals(dataclasses.replace(design, optics=optics), depth_m)[1].truth.psf.psf[0, 0]
        for optics in (None, Optics(stop_um=50.0), Optics(filter_fwhm_nm=40.0))
    )
    stopped, smeared = others
    # Sums are powers: a quarter of the light, at a sixteenth of the peak.
    assert stopped.sum() / plain.sum() == pytest.approx(0.25, rel=0.05)
    assert stopped.max() / plain.max() == pytest.approx(1.0 / 16.0, rel=0.2)
    assert smeared.sum() == pytest.approx(plain.sum(), rel=0.02)
    assert smeared.max() < 0.97 * plain.max()


def test_a_plain_lens_has_nothing_to_compare(design: Design) -> None:
    with pytest.raises(InputError, match="split_lens"):
        comparison.compare(dataclasses.replace(design, phase=(Lens(),)))
