"""A process is found again from sizes that an exposure predicts, with noise of the microscope."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.core.errors import InputError
from metafab.exposure import ExposureNumerics, expose
from metafab.exposure.fit import MeasuredLens, fit_process
from metafab.layout import PillarMap
from tests.physics.exposure.conftest import BEAM, disc, pattern

#: The true process, which the fit does not know: ratio of doses, backscatter, blur (nm), bias (nm), noise (nm).
RATIO, ETA, BLUR_NM, BIAS_NM, NOISE_NM = 2.1, 0.62, 14.0, -4.0, 1.0
DOSES = (0.85, 1.0, 1.2)


@pytest.fixture(scope="module")
def small_lens() -> PillarMap:
    rng = np.random.default_rng(3)
    return pattern(2.0 * rng.integers(50, 126, (100, 2)), disc(160, 100))


def measured(lens: PillarMap, doses: tuple[float, ...], noise_nm: float, seed: int = 1) -> MeasuredLens:
    """Sizes of 150 random pillars at each dose."""
    rng = np.random.default_rng(seed)
    index = lens.to_array()
    rows, columns = np.nonzero(index)
    places, sizes = [], []
    for dose in doses:
        found = expose(
            lens,
            BEAM.with_backscatter(ETA).blurred(BLUR_NM),
            base_over_clearing_dose=RATIO,
            lens_dose=dose,
            numerics=ExposureNumerics(keep_sizes=True),
        )
        assert found.printed_less_drawn_nm is not None
        chosen = rng.choice(rows.size, 150, replace=False)
        place = np.stack([rows[chosen], columns[chosen]], axis=1)
        change = found.printed_less_drawn_nm[:, place[:, 0], place[:, 1]].T.astype(float)
        size = lens.size_nm()[index[place[:, 0], place[:, 1]]] + change + BIAS_NM
        places.append(place)
        sizes.append(size + rng.normal(0.0, noise_nm, size.shape))
    return MeasuredLens(lens, np.concatenate(places), np.repeat(doses, 150), np.concatenate(sizes))


def test_without_noise_the_process_is_exact(small_lens: PillarMap) -> None:
    """The table of edges that predicts the sizes is in single precision: 1e-3 nm, on which all errors here depend."""
    fit = fit_process([measured(small_lens, DOSES, 0.0)], BEAM, 5.0, ("threshold", "eta", "blur", "bias"))
    assert fit.residual_rms_nm < 0.02
    assert fit.base_over_clearing_dose.value == pytest.approx(RATIO, rel=2e-3)
    assert fit.backscatter_ratio.value == pytest.approx(ETA, rel=5e-3)
    assert fit.blur_nm.value == pytest.approx(BLUR_NM, rel=5e-3)
    assert fit.bias_nm.value == pytest.approx(BIAS_NM, abs=0.05)


def test_with_noise_each_parameter_is_within_its_error(small_lens: PillarMap) -> None:
    """Four standard errors; the errors follow from 1 nm of noise and 900 sizes."""
    fit = fit_process([measured(small_lens, DOSES, NOISE_NM)], BEAM, 5.0, ("threshold", "eta", "blur", "bias"))
    assert (fit.sizes, fit.doses) == (900, 3)
    assert fit.residual_rms_nm == pytest.approx(NOISE_NM, rel=0.1)
    truths = (RATIO, ETA, BLUR_NM, BIAS_NM)
    for found, truth in zip(
        (fit.base_over_clearing_dose, fit.backscatter_ratio, fit.blur_nm, fit.bias_nm), truths, strict=True
    ):
        assert found.error is not None
        assert abs(found.value - truth) < 4.0 * found.error
        assert found.error < 0.25 * abs(truth)
    assert fit.bias_map.mean_nm.value == pytest.approx(fit.bias_nm.value, abs=0.01)
    tilt = fit.bias_map.tilt_x_nm_per_mm
    assert tilt.error is not None
    assert abs(tilt.value) < 4.0 * tilt.error


def test_a_tilt_of_the_bias_is_mapped(small_lens: PillarMap) -> None:
    """20 nm per mm along x, from an etch that is deeper on one side."""
    lens = measured(small_lens, (1.0, 1.2), 0.2)
    lens.size_nm[:] += 20.0 * lens.pillars.lattice.x_um()[lens.place[:, 1], None] * 1e-3
    fit = fit_process([lens], BEAM.with_backscatter(ETA), BLUR_NM)
    tilt_x, tilt_y = fit.bias_map.tilt_x_nm_per_mm, fit.bias_map.tilt_y_nm_per_mm
    assert tilt_x.error is not None and tilt_y.error is not None
    assert abs(tilt_x.value - 20.0) < 4.0 * tilt_x.error < 10.0
    assert abs(tilt_y.value) < 4.0 * tilt_y.error


def test_fixed_parameters_keep_their_values(small_lens: PillarMap) -> None:
    fit = fit_process([measured(small_lens, (1.0,), 0.5)], BEAM, 12.0, ("bias",), RATIO)
    assert fit.base_over_clearing_dose.value == RATIO
    assert fit.base_over_clearing_dose.error is None
    assert fit.blur_nm.value == 12.0
    assert (fit.largest_correlation, fit.correlated) == (0.0, ())


def test_a_parameter_at_its_bound_is_refused_by_name(small_lens: PillarMap) -> None:
    """All sizes 250 nm too large: beyond the bias that is fitted."""
    lens = measured(small_lens, (1.0,), 0.0)
    lens.size_nm[:] += 250.0
    with pytest.raises(
        InputError, match="`bias`: expected sizes that give one between -200 and 200, got the bound 200"
    ):
        fit_process([lens], BEAM.with_backscatter(ETA), BLUR_NM, ("bias",), RATIO)


def test_sizes_that_determine_nothing_are_refused(small_lens: PillarMap) -> None:
    lens = measured(small_lens, (1.0,), 0.0)
    one = MeasuredLens(lens.pillars, lens.place[:1], lens.dose[:1], lens.size_nm[:1])
    with pytest.raises(InputError, match="more sizes"):
        fit_process([one], BEAM, 5.0)
    # The same pillar again and again: three parameters from two sizes.
    same = MeasuredLens(lens.pillars, lens.place[[0] * 5], lens.dose[:5], lens.size_nm[[0] * 5])
    with pytest.raises(InputError, match="--free"):
        fit_process([same], BEAM, 5.0)
    with pytest.raises(InputError, match="base_over_clearing_dose"):
        fit_process([lens], BEAM, 5.0, ("bias",))
    with pytest.raises(InputError, match="backscatter_ratio"):
        fit_process([lens], BEAM.between(0.0, 1000.0), 5.0)
