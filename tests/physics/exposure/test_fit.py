"""A process is found again from sizes that an exposure predicts, with noise of the microscope."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.exposure import ExposedLens, ExposureNumerics, expose_lenses
from metafab.exposure.fit import fit_process
from metafab.exposure.size_model import MeasuredLens, Parameter
from metafab.layout import PillarMap
from metafab.spec.mask import Etch, ExposureProcess
from tests.physics.exposure.conftest import BEAM, PERIOD_NM, disc, pattern

#: The true process, which the fit does not know: ratio of doses, backscatter, blur (nm), bias (nm), noise (nm).
RATIO, ETA, BLUR_NM, BIAS_NM, NOISE_NM = 2.1, 0.62, 14.0, -4.0, 1.0
DOSES = (0.85, 1.0, 1.2)
#: Half angle of the beam and its best focus, for lenses out of focus; microloading (nm) and its range (um).
CONVERGENCE_MRAD, BEST_FOCUS_UM = 12.0, -0.3
LOADING_NM, LOADING_UM = 15.0, 6.0


@pytest.fixture(scope="module")
def small_lens() -> PillarMap:
    return lens_of_tests()


@cache
def lens_of_tests() -> PillarMap:
    rng = np.random.default_rng(3)
    return pattern(2.0 * rng.integers(50, 126, (100, 2)), disc(160, 100))


@cache
def printed_less_drawn_nm(dose: float, blur_nm: float) -> FloatArray:
    """Of the lens of these tests, shape (2, n_y, n_x): most of them expose it alike."""
    (found,) = expose_lenses(
        (ExposedLens(lens_of_tests(), dose=dose),),
        BEAM.with_backscatter(ETA).blurred(blur_nm),
        base_over_clearing_dose=RATIO,
        numerics=ExposureNumerics(keep_sizes=True),
    )
    assert found.printed_less_drawn_nm is not None
    return found.printed_less_drawn_nm.astype(float)


def beam(eta: float | None = None, blur_nm: float = 5.0, **keys: float) -> ExposureProcess:
    """The start of a fit: the beam without its blur."""
    return ExposureProcess(terms=BEAM.terms, blur_nm=blur_nm, backscatter_ratio=eta, **keys)


def measured(
    lens: PillarMap, doses: tuple[float, ...], noise_nm: float, seed: int = 1, focus_um: float = 0.0, count: int = 150
) -> MeasuredLens:
    """Sizes of random pillars at each dose."""
    rng = np.random.default_rng(seed)
    index = lens.to_array()
    rows, columns = np.nonzero(index)
    widened_nm = math.hypot(BLUR_NM, CONVERGENCE_MRAD * (focus_um - BEST_FOCUS_UM) / math.sqrt(2.0))
    blur_nm = widened_nm if focus_um else BLUR_NM
    places, sizes = [], []
    for dose in doses:
        chosen = rng.choice(rows.size, count, replace=False)
        place = np.stack([rows[chosen], columns[chosen]], axis=1)
        change = printed_less_drawn_nm(dose, blur_nm)[:, place[:, 0], place[:, 1]].T
        size = lens.size_nm()[index[place[:, 0], place[:, 1]]] + change + BIAS_NM
        places.append(place)
        sizes.append(size + rng.normal(0.0, noise_nm, size.shape))
    return MeasuredLens(lens, np.concatenate(places), np.repeat(doses, count), np.concatenate(sizes), focus_um)


def test_without_noise_the_process_is_exact(small_lens: PillarMap) -> None:
    """The table of edges that predicts the sizes is in single precision: 1e-3 nm, on which all errors here depend."""
    fit = fit_process([measured(small_lens, DOSES, 0.0)], beam(), ("threshold", "eta", "blur", "bias"))
    assert fit.residual_rms_nm < 0.02
    assert fit.base_over_clearing_dose.value == pytest.approx(RATIO, rel=2e-3)
    assert fit.backscatter_ratio.value == pytest.approx(ETA, rel=5e-3)
    assert fit.blur_nm.value == pytest.approx(BLUR_NM, rel=5e-3)
    assert fit.bias_nm.value == pytest.approx(BIAS_NM, abs=0.05)


def test_with_noise_each_parameter_is_within_its_error(small_lens: PillarMap) -> None:
    """Four standard errors; the errors follow from 1 nm of noise and 900 sizes."""
    fit = fit_process([measured(small_lens, DOSES, NOISE_NM)], beam(), ("threshold", "eta", "blur", "bias"))
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


def test_wrong_sizes_are_listed_and_do_not_move_the_fit(small_lens: PillarMap) -> None:
    """2 % of the sizes are 20 to 60 nm too large, which moves their mean by 0.8 nm.

    Huber's estimate of a mean moves by 0.02 x 1.345 standard deviations of a size: 0.8 of the error of a mean of 900.
    """
    lens, wrong = measured(small_lens, DOSES, NOISE_NM), np.arange(10, 450, 25)
    free: tuple[Parameter, ...] = ("threshold", "eta", "bias")
    clean = fit_process([lens], beam(None, BLUR_NM), free)
    lens.size_nm[wrong, wrong % 2] += np.linspace(20.0, 60.0, wrong.size)
    fit = fit_process([lens], beam(None, BLUR_NM), free)
    assert clean.far == ()
    assert sorted((far.row - 1, far.side) for far in fit.far) == [(n, ("width", "length")[n % 2]) for n in wrong]
    described = [str(far) for far in fit.far if far.row == 436]
    assert f"um: length {lens.size_nm[435, 1]:.1f} nm, +" in described[0]
    assert fit.residual_rms_nm == pytest.approx(NOISE_NM, rel=0.1)
    for name, truth in (("base_over_clearing_dose", RATIO), ("backscatter_ratio", ETA), ("bias_nm", BIAS_NM)):
        found, without = getattr(fit, name), getattr(clean, name)
        assert abs(found.value - truth) < 4.0 * found.error
        assert abs(found.value - without.value) < 1.5 * without.error
        assert found.error == pytest.approx(without.error, rel=0.15)


def test_a_tilt_of_the_bias_is_mapped(small_lens: PillarMap) -> None:
    """20 nm per mm along x, from an etch that is deeper on one side."""
    lens = measured(small_lens, (1.0, 1.2), 0.2)
    lens.size_nm[:] += 20.0 * lens.pillars.lattice.x_um()[lens.place[:, 1], None] * 1e-3
    fit = fit_process([lens], beam(ETA, BLUR_NM))
    tilt_x, tilt_y = fit.bias_map.tilt_x_nm_per_mm, fit.bias_map.tilt_y_nm_per_mm
    assert tilt_x.error is not None and tilt_y.error is not None
    assert abs(tilt_x.value - 20.0) < 4.0 * tilt_x.error < 10.0
    assert abs(tilt_y.value) < 4.0 * tilt_y.error


def test_fixed_parameters_keep_their_values(small_lens: PillarMap) -> None:
    fit = fit_process([measured(small_lens, (1.0,), 0.5)], beam(blur_nm=12.0, base_over_clearing_dose=RATIO), ("bias",))
    assert fit.base_over_clearing_dose.value == RATIO
    assert fit.base_over_clearing_dose.error is None
    assert fit.blur_nm.value == 12.0
    assert (fit.largest_correlation, fit.correlated) == (0.0, ())


def test_a_focus_dose_matrix_gives_the_angle_of_the_beam_and_its_focus(small_lens: PillarMap) -> None:
    """Four focuses of two doses each, 60 pillars with 1 nm of noise."""
    focuses, doses = (-2.5, -1.0, 1.0, 2.5), DOSES[::2]
    matrix = [measured(small_lens, doses, NOISE_NM, 7 + n, focus, 60) for n, focus in enumerate(focuses)]
    free = ("threshold", "blur", "bias", "convergence", "focus")
    fit = fit_process(matrix, beam(ETA, 10.0), free)
    assert (fit.sizes, fit.doses, fit.focuses) == (960, 2, 4)
    assert fit.convergence_mrad is not None
    for found, truth, largest in (
        (fit.convergence_mrad, CONVERGENCE_MRAD, 1.0),
        (fit.best_focus_um, BEST_FOCUS_UM, 0.2),
        (fit.blur_nm, BLUR_NM, 3.0),
    ):
        assert found.error is not None
        assert abs(found.value - truth) < 4.0 * found.error < 4.0 * largest
    with pytest.raises(InputError, match="convergence_mrad"):
        fit_process(matrix, beam(ETA, 10.0), ("threshold", "bias"))
    with pytest.raises(InputError, match=r"leave convergence open|`convergence`"):
        fit_process([measured(small_lens, DOSES, 0.0)], beam(ETA, 10.0), ("threshold", "bias", "convergence"))


def test_a_stated_blur_beyond_that_of_a_fit_counts_in_full(small_lens: PillarMap) -> None:
    """12.8 um out of focus: 110 nm of blur, where 100 nm are the most that a fitted one may have."""
    lens = measured(small_lens, (2.0, 2.6), 0.0, focus_um=12.5, count=40)
    start = beam(ETA, BLUR_NM, convergence_mrad=CONVERGENCE_MRAD, best_focus_um=BEST_FOCUS_UM)
    fit = fit_process([lens], start, ("threshold", "bias"))
    assert fit.residual_rms_nm < 0.1
    assert fit.base_over_clearing_dose.value == pytest.approx(RATIO, rel=2e-3)
    assert fit.bias_nm.value == pytest.approx(BIAS_NM, abs=0.2)


def test_microloading_is_told_from_backscatter_by_the_dose(small_lens: PillarMap) -> None:
    """The density by a filter of the drawn areas over sites; sizes of an etch that leaves wider pillars among many."""
    lens = measured(small_lens, DOSES, 0.2)
    index, size_nm = small_lens.to_array(), small_lens.size_nm()
    sigma = LOADING_UM * 1e3 / np.sqrt(2.0) / PERIOD_NM
    local = gaussian_filter(size_nm.prod(axis=1)[index] / PERIOD_NM**2, sigma, mode="constant", truncate=6.0)
    excess = local - local[index > 0].mean()
    lens.size_nm[:] += LOADING_NM * excess[lens.place[:, 0], lens.place[:, 1], None]
    etch = Etch(microloading_range_um=LOADING_UM)
    fit = fit_process([lens], beam(None, BLUR_NM), ("threshold", "eta", "bias", "microloading"), etch)
    assert fit.microloading_nm.error is not None and fit.backscatter_ratio.error is not None
    # The printed pillars are wider than the drawn ones by a few percent, and so is the density.
    assert abs(fit.microloading_nm.value - LOADING_NM) < 4.0 * fit.microloading_nm.error + 0.1 * LOADING_NM
    assert fit.microloading_nm.error < 0.2 * LOADING_NM
    assert abs(fit.backscatter_ratio.value - ETA) < 4.0 * fit.backscatter_ratio.error + 0.02
    plain = fit_process([lens], beam(None, BLUR_NM))
    assert plain.residual_rms_nm > 1.1 * fit.residual_rms_nm


def test_a_parameter_at_its_bound_is_refused_by_name(small_lens: PillarMap) -> None:
    """All sizes 250 nm too large: beyond the bias that is fitted."""
    lens = measured(small_lens, (1.0,), 0.0)
    lens.size_nm[:] += 250.0
    with pytest.raises(
        InputError, match="`bias`: expected sizes that give one between -200 and 200, got the bound 200"
    ):
        fit_process([lens], beam(ETA, BLUR_NM, base_over_clearing_dose=RATIO), ("bias",))


def test_one_dose_leaves_the_threshold_open(small_lens: PillarMap) -> None:
    """A bias and a threshold change all sizes alike; fixed, either one gives the other."""
    lens = measured(small_lens, (1.0,), 4.0, seed=4, count=40)
    with pytest.raises(InputError, match=r"`threshold`.* \+- .*leave `threshold` out of `free`"):
        fit_process([lens], beam(None, BLUR_NM))
    fit = fit_process([lens], beam(ETA, BLUR_NM, base_over_clearing_dose=RATIO), ("bias",))
    assert fit.bias_nm.value == pytest.approx(BIAS_NM, abs=2.0)


def test_sizes_that_determine_nothing_are_refused(small_lens: PillarMap) -> None:
    lens = measured(small_lens, (1.0,), 0.0)
    one = MeasuredLens(lens.pillars, lens.place[:1], lens.dose[:1], lens.size_nm[:1])
    with pytest.raises(InputError, match="more sizes"):
        fit_process([one], beam())
    # The same pillar again and again: three parameters from two sizes.
    same = MeasuredLens(lens.pillars, lens.place[[0] * 5], lens.dose[:5], lens.size_nm[[0] * 5])
    with pytest.raises(InputError, match=r"fit fewer \(`free`\)"):
        fit_process([same], beam())
    with pytest.raises(InputError, match="base_over_clearing_dose"):
        fit_process([lens], beam(), ("bias",))
    with pytest.raises(InputError, match="backscatter_ratio"):
        fit_process([lens], ExposureProcess(terms=BEAM.terms[:1]))
