"""Rational models of different degrees, ranked by held-out samples: their disagreement estimates their error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from metafab.core.conventions import FloatArray
from metafab.library.fit.rational import Range, RationalModel, Samples, Shape, fit_model
from metafab.library.fit.size_grid import refined_axis

#: Degrees of the denominator that are tried.
DENOMINATOR_DEGREES = (7, 10, 12)
#: Largest degree of the numerators, for sizes alone and with axes.
LARGEST_DEGREE, LARGEST_CORNER_DEGREE = 16, 18
#: Largest number of unknowns per equation; a value below 1 suppresses noise and spurious poles.
FILLING = 0.7
#: Degrees of denominators and of the numerators for sweeps with many guided modes (TiO2 in the visible); tried only
#: with enough samples. Two denominators, so that a model of many modes has a rival that is about as good: silicon at
#: 1550 nm had one with half of its terms, and 673 of 2401 sizes beyond their target by the difference.
MANY_MODES_DENOMINATORS, MANY_MODES_DEGREE = (14, 16), 22
#: Unknowns per equation of such models.
MANY_MODES_FILLING = 0.35
#: Weights of an axis that are tried.
WEIGHTS = (2, 3)
#: Largest number of ranked models over sizes and axes; two could agree by chance where samples are sparse.
CORNER_MODELS = 3
#: Smallest number of unknowns per equation of a model with axes; smaller models waste samples.
LEAST_FILLING = 0.25


@dataclass(frozen=True)
class RankedModels:
    """The models with the smallest held-out errors."""

    best: RationalModel  #: The model that is used.
    #: Next best models, of other degrees; their difference from ``best`` estimates its error.
    rivals: tuple[RationalModel, ...]

    def disagreement(self, width_nm: FloatArray, length_nm: FloatArray, *, around: bool = False) -> FloatArray:
        """Return the largest difference of any amplitude between the best model and a rival: shape (n_length, n_width).

        The grid of sizes has the axes ``width_nm``, shape (n_width,), and ``length_nm``. With ``around``, the largest
        difference up to half a step around each size counts, which detects spurious poles.
        """
        if around:
            fine = self.disagreement(refined_axis(width_nm, 2), refined_axis(length_nm, 2))
            return np.asarray(maximum_filter(fine, size=3, mode="nearest")[::2, ::2], dtype=np.float64)
        best = self.best.on_grid(width_nm, length_nm)
        differences = [np.abs(best - rival.on_grid(width_nm, length_nm)).max(axis=0) for rival in self.rivals]
        return np.asarray(np.max(differences, axis=0), dtype=np.float64)

    def at(self, axes: FloatArray, bias_nm: float) -> RankedModels:
        """Return the models of one corner: axes, shape (n_variables,), each in -1..1, and bias of width and length."""
        return RankedModels(self.best.at(axes, bias_nm), tuple(rival.at(axes, bias_nm) for rival in self.rivals))


def fit_size_models(
    samples: Samples, held_out: NDArray[np.bool_], spans_nm: tuple[Range, Range], exchange: bool
) -> RankedModels:
    """Rank degrees of models over sizes alone by their error at held-out samples, then fit the two best to all samples.

    ``held_out``, shape (n,), is True for samples that rank the degrees; ``spans_nm`` are the ranges of width and
    length; ``exchange`` says whether t_yy(W, L) = t_xx(L, W).
    """

    def fit(some: Samples, shape: Shape) -> RationalModel:
        # Many guided modes need every coefficient of the denominator, and the samples determine them unpenalised.
        penalised = shape.degrees[0] <= LARGEST_DEGREE
        mirrored = some.width_nm != some.length_nm if exchange else None
        return fit_model(some, shape, spans_nm, mirrored, penalised)

    equations = samples[~held_out].equations * (2 if exchange else 1)
    return _fit_ranked(samples, held_out, _size_shapes(equations), fit, 2)


def fit_corner_models(
    samples: Samples, held_out: NDArray[np.bool_], spans_nm: tuple[Range, Range], exchange: bool
) -> RankedModels:
    """Rank shapes of models over sizes and axes by their error at held-out samples, then fit the best to all samples.

    The arguments are those of :func:`fit_size_models`; ``held_out`` has the shape (n,), ``exchange`` holds at every
    corner. Samples of equal widths and lengths are circles.
    """

    def fit(some: Samples, shape: Shape) -> RationalModel:
        return fit_model(some, shape, spans_nm, np.ones(some.width_nm.size, dtype=bool) if exchange else None)

    sizes = 1 if np.array_equal(samples.width_nm, samples.length_nm) else 2
    # The mirror image of a circle is the circle itself: no equation more.
    equations = samples[~held_out].equations * (2 if exchange and sizes == 2 else 1)
    shapes = corner_shapes(equations, samples.axes.shape[1], sizes)
    # The worst candidate is not used as a rival.
    return _fit_ranked(samples, held_out, shapes, fit, max(2, min(CORNER_MODELS, len(shapes) - 1)))


def _fit_ranked(
    samples: Samples,
    held_out: NDArray[np.bool_],
    shapes: list[Shape],
    fit: Callable[[Samples, Shape], RationalModel],
    count: int,
) -> RankedModels:
    known, unknown = samples[~held_out], samples[held_out]

    def held_out_error(shape: Shape) -> float:
        # The mean, not the rms: one sample on a narrow resonance would decide between models by chance.
        predicted = fit(known, shape)(unknown.width_nm, unknown.length_nm, unknown.axes)
        return float(np.mean(np.abs(predicted - unknown.amplitudes)))

    best, *rivals = (fit(samples, shape) for shape in sorted(shapes, key=held_out_error)[:count])
    return RankedModels(best, tuple(rivals))


def corner_shapes(equations: int, variables: int, sizes: int = 2) -> list[Shape]:
    """Return the shapes that a number of samples can determine: the largest numerator for each denominator.

    ``equations`` counts the samples of one polarisation, ``variables`` the axes; ``sizes`` is that of
    :class:`~metafab.library.fit.rational.Shape`.
    """
    largest = []
    for weight, below in product(WEIGHTS if variables else WEIGHTS[:1], DENOMINATOR_DEGREES):
        fitting = [Shape((above, below), weight, variables, sizes) for above in range(1, LARGEST_CORNER_DEGREE + 1)]
        largest += [shape for shape in fitting if shape.unknowns <= FILLING * 2 * equations][-1:]
    rich = [shape for shape in largest if shape.unknowns >= LEAST_FILLING * 2 * equations]
    # Without variables (a bias alone) there are many samples, and even the largest shapes fall below LEAST_FILLING.
    shapes = rich if len(rich) > 1 else largest
    return shapes if len(shapes) > 1 else [Shape((top, 0), 2, variables, sizes) for top in (2, 1)]


def _size_shapes(equations: int) -> list[Shape]:
    """Shapes over sizes alone that a number of samples of one polarisation can determine."""
    shapes: list[Shape] = []
    for below in (*DENOMINATOR_DEGREES, *MANY_MODES_DENOMINATORS):
        rich = _largest_numerator(below, MANY_MODES_DEGREE, MANY_MODES_FILLING * 2 * equations)
        top = rich
        if below in DENOMINATOR_DEGREES:
            top = _largest_numerator(below, LARGEST_DEGREE, FILLING * 2 * equations)
        if top:
            degrees = {top, max(3 * top // 4, 1), *({rich} & {MANY_MODES_DEGREE})}
            shapes += [Shape((above, below)) for above in sorted(degrees)]
    return shapes if len(shapes) > 1 else [Shape((2, 0)), Shape((1, 0))]


def _largest_numerator(below: int, largest: int, unknowns: float) -> int:
    """Largest numerator degree with at most this many unknowns, the denominator's included; 0 if there is none."""
    fitting = [above for above in range(1, largest + 1) if Shape((above, below)).unknowns <= unknowns]
    return fitting[-1] if fitting else 0
