"""Tolerances of a written mask: PSFs, efficiency, extinction and depth at its corners, in one table.

The mask is read and its pillars are summed in blocks once. A corner of the cell sums them again with other amplitudes
(:mod:`metafab.tolerance.corners`). Random faults change the block sums themselves: by their mean, and by what they
scatter (:mod:`metafab.tolerance.scatter`), so that many draws cost no more than their PSFs.

The depth error is what a decoder reports that was calibrated on the nominal mask: it filters the image of each
polarisation by the other's PSF at a trial depth, and takes the depth at which the two agree best.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.parallel.executor import default_workers
from metafab.core.parallel.progress import Progress, silent
from metafab.library.library import Library
from metafab.optics.geometry.imaging import Imaging, depth_nodes
from metafab.optics.interpolation.field import spline_weights
from metafab.optics.measures.lobe import main_lobe_px, orientation_deg
from metafab.optics.propagation.blocks import reduce_to_target, require_memory
from metafab.optics.propagation.image import Window, relative_l2
from metafab.optics.propagation.pupil import Carrier, Pupil, reduce_field
from metafab.optics.sources.apodisation import Transmission, apodised
from metafab.optics.sources.source import Source, WrittenField
from metafab.optics.validation import require_answerable
from metafab.spec.design import Tolerances
from metafab.tolerance.corners import CornerField, corner_fields
from metafab.tolerance.scatter import Fault, Misplaced, Missing, Stitched

#: The decoder looks beyond the depths of the table by this share of their range of vergence, at this many depths for
#: each that its calibration holds.
_MARGIN, _TRIALS = 0.25, 6
#: What random faults shift one way, whose mean over draws is told; of the rest, which goes both ways, it is the rms.
_OF_DRAWS_THE_MEAN = ("peak_ratio", "efficiency", "efficiency_change", "extinction_ratio")


@dataclass(frozen=True)
class ToleranceRow:
    """One corner beside the nominal mask; the worst of both polarisations and all depths.

    Of draws, change, turn and depth error are their rms, the rest their mean.

    Attributes:
        corner: its name.
        change: relative L2 change of the irradiance.
        peak_ratio: smallest peak over the nominal one.
        efficiency: smallest share of the power in the window.
        efficiency_change: largest change of that share, with its sign.
        extinction_ratio: smallest ratio of wanted over unwanted light in x's window.
        turn_deg: largest turn of the main lobe of PSF_x, with its sign.
        depth_error_m: largest error of the finite depths that a decoder reports, with its sign; NaN where the pair
            does not turn, or where no depth in reach agrees.
        relative_error: error of these changes over the changes: of the corner's amplitudes, or of so few draws.
        draws: random masks; 0 for a corner that is not random.
        solved: cells that were solved for it.
        below_error: whether the PSFs change by no more than they err by: the row then means "no more than the error".
    """

    corner: str
    change: float
    peak_ratio: float
    efficiency: float
    efficiency_change: float
    extinction_ratio: float
    turn_deg: float
    depth_error_m: float
    relative_error: float
    draws: int = 0
    solved: int = 0
    below_error: bool = False


@dataclass(frozen=True)
class ToleranceTable:
    """All corners of a mask.

    Attributes:
        nominal: the mask as it should be, beside itself.
        rows: its corners.
        depth_m: shape (n,), object depths.
        error: relative L2 error of any PSF; smaller changes mean nothing.
        block_sites: sites a side of a block.
    """

    nominal: ToleranceRow
    rows: tuple[ToleranceRow, ...]
    depth_m: FloatArray
    error: float
    block_sites: int


@dataclass(frozen=True)
class _Light:
    """What the table compares: irradiance (2, n_depth, n, n), and unwanted power (n_depth,) in x's window."""

    pair: FloatArray
    unwanted: FloatArray
    pixel_um: float

    @property
    def efficiency(self) -> FloatArray:
        return np.asarray(self.pair.sum(axis=(2, 3)) * self.pixel_um**2)

    @property
    def extinction(self) -> FloatArray:
        with np.errstate(divide="ignore"):
            return np.asarray(self.efficiency[0] / self.unwanted)


@dataclass(frozen=True)
class _Bench:
    """A mask's blocks at one size, and the PSFs that they give."""

    window: Window
    depths_m: tuple[float, ...]
    carriers: tuple[Carrier, Carrier, Carrier]
    transmission: Transmission | None = None
    filter_fwhm_nm: float | None = None
    target_error: float = 1e-3

    def sums(self, source: Source) -> list[Pupil]:
        """Blocks of x and y, and of y behind x's carrier."""
        return reduce_field(apodised(source, self.transmission), self.carriers, self.window.imaging.wavenumber)

    def light(self, pupils: Sequence[Pupil]) -> _Light:
        """The pair and the unwanted light of some blocks."""
        asked = ((0.0, 0.0), self.depths_m, self.filter_fwhm_nm, self.target_error)
        pair = [self.window.light([pupils[p]], p, *asked)[0] for p in (0, 1)]
        stray = self.window.stray_irradiance(pupils[2], 0, (0.0, 0.0), self.depths_m)
        pixel_um = self.window.imaging.pixel_um
        return _Light(np.array(pair), stray.sum(axis=(1, 2)) * pixel_um**2, pixel_um)


def tolerance_table(
    written: WrittenField,
    library: Library,
    imaging: Imaging,
    depths_m: Sequence[float],
    tolerances: Tolerances,
    field_sites: int,
    *,
    window_px: int = 64,
    target_error: float = 1e-3,
    transmission: Transmission | None = None,
    filter_fwhm_nm: float | None = None,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> ToleranceTable:
    """PSFs at the corners of a written mask against those of the mask as it should be, on the axis.

    Args:
        written: the mask with the library's amplitudes.
        library: what it was made with.
        imaging: geometry.
        depths_m: object depths, ascending.
        tolerances: how far fabrication goes; zeros leave corners out.
        field_sites: sites a side of a write field.
        window_px: points a side of each window.
        target_error: of every PSF.
        transmission: of a stop or an amplitude in the plane of the pillars; None for none.
        filter_fwhm_nm: full width of a filter before the sensor; None for one wavelength. Unwanted light stays that of
            the design wavelength.
        executor: solves cells; this process when None. The result is the same.
        progress: called as corners are done.

    Raises:
        InputError: what no stack can answer (:func:`metafab.optics.psf`), or write fields of a number of sites whose
            divisors are so small that stitching takes more blocks than fit into memory.
    """
    depths = [float(z) for z in depths_m]
    require_answerable(imaging, depths, (0.0, 0.0), None, window_px, target_error, filter_fwhm_nm)
    window = Window.for_target(imaging, window_px, target_error)
    windows = window.over_band((0.0, 0.0), filter_fwhm_nm)
    # Blocks and wavelengths share the target.
    target_error *= 1.0 if filter_fwhm_nm is None else 0.5
    with threadpool_limits(1, "blas"), ThreadPoolExecutor(default_workers()) as threads:
        pyramids, stray = reduce_to_target(
            apodised(written, transmission), windows, depths, (0.0, 0.0), None, target_error, threads, progress
        )
        asked = ((0.0, 0.0), depths, filter_fwhm_nm, target_error)
        error = float(max(window.light(pyramids[p], p, *asked)[1].max() for p in (0, 1)))
        carriers = (pyramids[0][0].carrier, pyramids[1][0].carrier, stray.carrier)
        faults = _faults(tolerances, imaging, written, field_sites)
        _require_memory(faults, written, pyramids[0][0].carrier.block_sites)
        bench = _Bench(window, tuple(depths), carriers, transmission, filter_fwhm_nm, target_error)
        pupils = [pyramids[0][0], pyramids[1][0], stray]
        judge = _Judge.of(bench, pupils, error)
        corners = corner_fields(written, library, _deviations(tolerances), executor=executor, progress=progress)
        rows = []
        for done, corner in enumerate(corners):
            rows.append(judge.corner(corner, bench.light(bench.sums(corner.field))))
            progress("tolerance", done + 1, len(corners))
        rows += [judge.draws(fault, bench, pupils, written, tolerances) for fault in faults]
    nominal = judge.row("nominal", [judge.nominal], 0.0)
    return ToleranceTable(nominal, tuple(rows), np.array(depths), error, pyramids[0][0].carrier.block_sites)


def _deviations(tolerances: Tolerances) -> dict[str, float]:
    named = {
        "cd_bias_nm": tolerances.cd_bias_nm,
        "height_nm": tolerances.height_nm,
        "sidewall_angle_deg": tolerances.sidewall_deg,
        "pillar_n_shift": tolerances.pillar_n,
    }
    return {name: value for name, value in named.items() if value > 0.0}


def _faults(tolerances: Tolerances, imaging: Imaging, written: WrittenField, field_sites: int) -> list[Fault]:
    faults: list[Fault] = []
    if tolerances.misplacement_nm > 0.0:
        faults.append(Misplaced(imaging, tolerances.misplacement_nm))
    # Where one field holds the whole lens, nothing is stitched.
    if tolerances.stitching_nm > 0.0 and max(written.lattice.shape) > field_sites:
        faults.append(Stitched(imaging, tolerances.stitching_nm, field_sites, written.lattice))
    if tolerances.missing_share > 0.0:
        faults.append(Missing(tolerances.missing_share))
    return faults


def _require_memory(faults: Sequence[Fault], written: WrittenField, wanted: int) -> None:
    """Refuse write fields that only blocks of too few sites divide, before any corner is solved."""
    for fault in faults:
        block = fault.block_sites(wanted)
        if block < wanted:
            require_memory(
                written, block, "mask.write_field_um", f"write fields of another number of sites, best of {wanted} n,",
                "change the write field by a few sites, or leave stitching out: `tolerance.stitching_nm` = 0",
            )  # fmt: skip


def _with_blocks(carriers: tuple[Carrier, Carrier, Carrier], block: int) -> tuple[Carrier, Carrier, Carrier]:
    x, y, stray = (replace(carrier, block_sites=block) for carrier in carriers)
    return x, y, stray


@dataclass(frozen=True)
class _Judge:
    """The nominal mask: its PSFs at the depths of the table, and what a decoder knows of it.

    Attributes:
        nominal: light at the depths of the table.
        depths_m: these depths.
        trial_m: shape (n_trial,), depths that the decoder tries.
        transfer: shape (2, n_trial, n, m), spectra of the nominal pair there.
        own_m: shape (n_depth,), what it reports for the nominal mask itself.
        error: relative L2 error of any PSF.
    """

    nominal: _Light
    depths_m: tuple[float, ...]
    trial_m: FloatArray
    transfer: ComplexArray
    own_m: FloatArray
    error: float

    @classmethod
    def of(cls, bench: _Bench, pupils: Sequence[Pupil], error: float) -> _Judge:
        near, far = 1.0 / bench.depths_m[0], 1.0 / bench.depths_m[-1]
        margin = max(_MARGIN * (near - far), 0.02 * near)
        farthest_m = 1.0 / max(far - margin, 1e-3 * far) if far > 0.0 else math.inf
        nodes = depth_nodes(bench.window.imaging, 1.0 / (near + margin), farthest_m, 1e-3)
        stack = replace(bench, depths_m=tuple(nodes.tolist())).light(pupils).pair
        vergence = np.linspace(1.0 / nodes[0], 1.0 / nodes[-1], _TRIALS * nodes.size)
        weights = spline_weights(1.0 / nodes, vergence)
        transfer = np.einsum("td,pdij->ptij", weights, np.fft.rfft2(stack), optimize=True)
        nominal = bench.light(pupils)
        with np.errstate(divide="ignore"):
            trial_m = 1.0 / vergence
        own_m = _reported_depth_m(nominal.pair, trial_m, transfer)
        return cls(nominal, bench.depths_m, trial_m, transfer, own_m, error)

    def corner(self, corner: CornerField, light: _Light) -> ToleranceRow:
        """The row of a corner of the cell."""
        row = self.row(corner.name, [light], corner.relative_error)
        return replace(row, solved=corner.solved)

    def draws(
        self, fault: Fault, bench: _Bench, pupils: Sequence[Pupil], written: WrittenField, tolerances: Tolerances
    ) -> ToleranceRow:
        """The row of a random fault, over some masks."""
        block = fault.block_sites(pupils[0].carrier.block_sites)
        judge = self
        if block != pupils[0].carrier.block_sites:
            bench = replace(bench, carriers=_with_blocks(bench.carriers, block))
            pupils = bench.sums(written)
            judge = replace(self, nominal=bench.light(pupils))
        lights = [bench.light(fault(pupils, np.random.default_rng((draw, 1)))) for draw in range(tolerances.draws)]
        row = judge.row(fault.name, lights, float(1.0 / np.sqrt(2.0 * tolerances.draws)))
        return replace(row, draws=tolerances.draws)

    def row(self, name: str, lights: Sequence[_Light], relative_error: float) -> ToleranceRow:
        """Figures of one light, sign and all, or over several draws: their rms, or mean."""
        figures = [self._figures(light) for light in lights]
        values = {key: np.array([figure[key] for figure in figures]) for key in figures[0]}
        one = len(lights) == 1
        pooled = {key: float(v[0]) if one else float(np.sqrt(np.mean(v**2))) for key, v in values.items()}
        if not one:
            pooled |= {key: float(values[key].mean()) for key in _OF_DRAWS_THE_MEAN}
        below_error = pooled["change"] <= self.error
        return ToleranceRow(name, **pooled, relative_error=relative_error, below_error=below_error)  # type: ignore[arg-type]

    def _figures(self, light: _Light) -> dict[str, float]:
        before, after = self.nominal, light
        n_depth, finite = len(self.depths_m), np.isfinite(self.depths_m)
        depth_error_m = _reported_depth_m(after.pair, self.trial_m, self.transfer) - self.own_m
        turn = (orientation_deg(after.pair[0]) - orientation_deg(before.pair[0]) + 180.0) % 360.0 - 180.0
        peaks = [[main_lobe_px(image)[2] for image in stack] for stack in after.pair]
        nominal_peaks = [[main_lobe_px(image)[2] for image in stack] for stack in before.pair]
        return {
            "change": max(relative_l2(after.pair[p, d], before.pair[p, d]) for p in (0, 1) for d in range(n_depth)),
            "peak_ratio": float((np.array(peaks) / np.array(nominal_peaks)).min()),
            "efficiency": float(after.efficiency.min()),
            "efficiency_change": _largest(after.efficiency - before.efficiency),
            "extinction_ratio": float(after.extinction.min()),
            "turn_deg": _largest(turn),
            "depth_error_m": _largest(depth_error_m[finite]) if finite.any() else math.nan,
        }


def _reported_depth_m(pair: FloatArray, trial_m: FloatArray, transfer: ComplexArray) -> FloatArray:
    """Depths at which the twins of points agree best, shape (n_depth,); NaN at an end of the trials."""
    reported = []
    for one, other in zip(*np.fft.rfft2(pair), strict=True):
        filtered, twin = one * transfer[1], other * transfer[0]
        agreement = _inner(filtered, twin) / np.sqrt(_inner(filtered, filtered) * _inner(twin, twin))
        reported.append(_best(1.0 / trial_m, agreement))
    return np.array(reported)


def _inner(a: ComplexArray, b: ComplexArray) -> FloatArray:
    """Inner product of half spectra over their last two axes; columns but the first stand for two."""
    weight = np.full(a.shape[-1], 2.0)
    weight[0] = 1.0
    return np.asarray(((a.real * b.real + a.imag * b.imag) @ weight).sum(axis=-1))


def _best(vergence: FloatArray, agreement: FloatArray) -> float:
    """Depth of the largest agreement, by a parabola through it and its neighbours."""
    k = int(np.argmax(agreement))
    if k in {0, agreement.size - 1}:
        return float("nan")
    below, at, above = agreement[k - 1 : k + 2]
    shift = 0.5 * (above - below) / (2.0 * at - below - above)
    return float(1.0 / (vergence[k] + shift * (vergence[1] - vergence[0])))


def _largest(values: FloatArray) -> float:
    """The value of the largest modulus, with its sign; NaN if any is."""
    flat = np.asarray(values).ravel()
    return float("nan") if np.isnan(flat).any() else float(flat[int(np.argmax(np.abs(flat)))])
