"""PSFs, efficiency, extinction, decoded depth and focus at the corners of a written mask, against the nominal mask.

The mask is read and its pillars are summed in blocks once. A corner of the cell sums them again with other amplitudes
(:mod:`metafab.tolerance.corners`). Random faults act on the block sums themselves (:mod:`metafab.tolerance.scatter`),
so that a draw costs no more than its PSFs.

The depth error is that of a decoder calibrated on the nominal mask. It filters the image of each polarisation by the
other's PSF at a trial depth, and takes the depth of the largest correlation of the two.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.errors import InputError
from metafab.core.figures import ToleranceRow, ToleranceTable
from metafab.core.numeric.interpolation import parabolic_maximum, spline_weights
from metafab.core.parallel.executor import one_blas_thread
from metafab.core.parallel.work import Work
from metafab.core.storage.files import read_json, write_json
from metafab.core.storage.tables import typed
from metafab.decode.matching.cost_volume import correlation
from metafab.library.library import Library
from metafab.optics.geometry.imaging import Imaging, depth_nodes
from metafab.optics.measures.focus import LensFocus
from metafab.optics.measures.metrics import main_lobe_px, orientation_deg
from metafab.optics.numerics import PsfNumerics, require_valid
from metafab.optics.propagation.blocks import MOST_BLOCKS, reduce_to_target, require_memory
from metafab.optics.propagation.image import Window, relative_l2
from metafab.optics.propagation.pupil import Carrier, Pupil, reduce_field
from metafab.optics.sources.source import Source, Transmission, WrittenField, apodised
from metafab.spec.design import Tolerances
from metafab.tolerance.corners import CornerField, corner_fields
from metafab.tolerance.scatter import Fault, Misplaced, Missing, Stitched

#: Trial depths of the decoder: their margin beyond the table's depths, as a share of the range of vergence, and their
#: number per depth of the calibration.
_MARGIN, _TRIALS = 0.25, 6
#: Over draws, figures with a systematic shift are averaged; the others have both signs and are given as rms.
_MEAN_OVER_DRAWS = (
    "peak_ratio",
    "efficiency",
    "efficiency_change",
    "extinction_ratio",
    "fwhm_x_um",
    "fwhm_y_um",
    "strehl",
)
_RMS_OVER_DRAWS = ("change", "turn_deg", "depth_error_m")
_AXIS = (0.0, 0.0)
#: Shortest distance of a main lobe from the image point, in wavelengths / NA: half of Airy's width at half maximum.
_ARM = 0.25
KIND = "metafab tolerance"
FORMAT = 1


@dataclass(frozen=True)
class Light:
    """Irradiance behind one mask."""

    pair: FloatArray  #: Shape (2, n_depth, n, n), 1/um^2 per unit power at the aperture.
    #: Shape (n_depth,), power of y polarised light in the window of x; NaN where one window holds both polarisations.
    unwanted: FloatArray
    pixel_um: float  #: Sampling step.
    #: Widths of a lens' focus along x and y, um, and its maximum per unit of transmitted power, 1/um^2.
    spot: tuple[float, float, float] = (math.nan, math.nan, math.nan)

    @property
    def efficiency(self) -> FloatArray:
        """Share of the power in the window, shape (2, n_depth)."""
        return np.asarray(self.pair.sum(axis=(2, 3)) * self.pixel_um**2)

    @property
    def extinction(self) -> FloatArray:
        """Wanted over unwanted power in the window of x, shape (n_depth,)."""
        with np.errstate(divide="ignore"):
            return np.asarray(self.efficiency[0] / self.unwanted)


@dataclass(frozen=True)
class MaskOptics:
    """Propagation of masks of one lattice in blocks of fixed size."""

    window: Window  #: Sampling of the windows.
    depths_m: tuple[float, ...]  #: Object depths.
    carriers: tuple[Carrier, Carrier, Carrier]  #: Carriers of x, of y, and of y polarised light in the window of x.
    numerics: PsfNumerics = PsfNumerics()  #: Target error and spectral band.
    transmission: Transmission | None = None  #: Stop or amplitude in the plane of the pillars; None for none.
    lens: LensFocus | None = None  #: Focus that is measured; None for devices without one.

    @classmethod
    def of(
        cls,
        written: WrittenField,
        imaging: Imaging,
        depths_m: Sequence[float],
        numerics: PsfNumerics,
        transmission: Transmission | None = None,
        work: Work = Work(),
        lens: LensFocus | None = None,
    ) -> tuple[MaskOptics, list[Pupil], float]:
        """Return the optics with the coarsest blocks that keep the target error, the blocks of the mask, and the error.

        InputError for inputs for which no PSF stack exists.
        """
        depths = [float(z) for z in depths_m]
        require_valid(imaging, depths, _AXIS, None, numerics)
        window = Window.for_target(imaging, numerics)
        windows = window.over_band(_AXIS, numerics.filter_fwhm_nm)
        here = Work(progress=work.progress)
        with here.threads() as threads:
            pyramids, stray = reduce_to_target(
                apodised(written, transmission), windows, depths, _AXIS, None, numerics.block_error, threads, here
            )
        error = max(float(window.light(pyramids[p], p, _AXIS, depths, numerics)[1].max()) for p in (0, 1))
        pupils = [pyramids[0][0], pyramids[1][0], stray]
        carriers = (pupils[0].carrier, pupils[1].carrier, pupils[2].carrier)
        return cls(window, tuple(depths), carriers, numerics, transmission, lens), pupils, error

    def with_blocks(self, block_sites: int) -> MaskOptics:
        """Return the same optics with blocks of another size."""
        x, y, stray = (replace(carrier, block_sites=block_sites) for carrier in self.carriers)
        return replace(self, carriers=(x, y, stray))

    def sums(self, source: Source) -> list[Pupil]:
        """Return the blocks of x, of y, and of y behind the carrier of x."""
        return reduce_field(apodised(source, self.transmission), self.carriers, self.window.imaging.wavenumber)

    def light(self, pupils: Sequence[Pupil]) -> Light:
        """Return the pair and the unwanted light of some blocks."""
        pair = [self.window.light([pupils[p]], p, _AXIS, self.depths_m, self.numerics)[0] for p in (0, 1)]
        stray = self.window.stray_irradiance(pupils[2], 0, _AXIS, self.depths_m)
        if self.window.imaging.crystal is not None:
            stray = stray + self.window.light([pupils[0]], 0, _AXIS, self.depths_m, self.numerics, entry=(0, 1))[0]
        pixel_um = self.window.imaging.pixel_um
        unwanted = stray.sum(axis=(1, 2)) * pixel_um**2 if self.is_pair else np.full(len(self.depths_m), math.nan)
        light = Light(np.array(pair), unwanted, pixel_um)
        return light if self.lens is None else replace(light, spot=self._spot(self.lens, pupils))

    @property
    def ideal_peak(self) -> float:
        """Maximum of the ideal lens' focus per unit of transmitted power, 1/um^2; NaN for devices without a focus."""
        return math.nan if self.lens is None else self._spot(self.lens, self.sums(self.lens.perfect))[2]

    def _spot(self, lens: LensFocus, pupils: Sequence[Pupil]) -> tuple[float, float, float]:
        return lens.spot(pupils, self.window.imaging, self.numerics.target_error)

    @property
    def is_pair(self) -> bool:
        """Whether the images of both polarisations lie apart; one window has no extinction and no twins to decode."""
        points = [self.window.imaging.image_point_um(p, _AXIS) for p in (0, 1)]
        return abs(points[0][0] - points[1][0]) >= self.window.imaging.pixel_um


@dataclass(frozen=True)
class DepthDecoder:
    """Depth from the twin images of a point, by the calibration of the nominal mask."""

    trial_m: FloatArray  #: Shape (n_trial,), trial depths, evenly spaced in vergence.
    transfer: ComplexArray  #: Shape (2, n_trial, n, m), half spectra of the nominal pair at the trial depths.

    @classmethod
    def of(cls, optics: MaskOptics, pupils: Sequence[Pupil]) -> DepthDecoder:
        """Calibrate on the blocks of the nominal mask."""
        near, far = 1.0 / optics.depths_m[0], 1.0 / optics.depths_m[-1]
        margin = max(_MARGIN * (near - far), 0.02 * near)
        farthest_m = 1.0 / max(far - margin, 1e-3 * far) if far > 0.0 else math.inf
        nodes = depth_nodes(optics.window.imaging, 1.0 / (near + margin), farthest_m, 1e-3)
        stack = replace(optics, depths_m=tuple(nodes.tolist()), lens=None).light(pupils).pair
        vergence = np.linspace(1.0 / nodes[0], 1.0 / nodes[-1], _TRIALS * nodes.size)
        weights = spline_weights(1.0 / nodes, vergence)
        with np.errstate(divide="ignore"):
            trial_m = 1.0 / vergence
        return cls(trial_m, np.einsum("td,pdij->ptij", weights, np.fft.rfft2(stack), optimize=True))

    def depth_m(self, pair: FloatArray) -> FloatArray:
        """Return the depths of points from their images, shape (2, n_depth, n, n).

        Shape (n_depth,); NaN where the correlation is largest at an end of the trial depths.
        """
        vergence = 1.0 / self.trial_m
        depths = []
        for one, other in zip(*np.fft.rfft2(pair), strict=True):
            filtered, twin = one * self.transfer[1], other * self.transfer[0]
            parts = np.array([_inner(filtered, twin), _inner(filtered, filtered), _inner(twin, twin)])
            place = parabolic_maximum(correlation(parts))
            depths.append(1.0 / (vergence[0] + place * (vergence[1] - vergence[0])))
        return np.array(depths)


def _inner(a: ComplexArray, b: ComplexArray) -> FloatArray:
    """Inner product of half spectra over their last two axes; columns but the first count twice."""
    weight = np.full(a.shape[-1], 2.0)
    weight[0] = 1.0
    return np.asarray(((a.real * b.real + a.imag * b.imag) @ weight).sum(axis=-1))


@dataclass(frozen=True)
class Reference:
    """Light and decoded depths of the nominal mask, with which other masks are compared."""

    nominal: Light  #: Light at the depths of the table.
    depths_m: tuple[float, ...]  #: Depths of the table.
    decoder: DepthDecoder | None  #: Decoder calibrated on the nominal mask; None where one window holds both images.
    decoded_m: FloatArray  #: Shape (n_depth,), decoded depths of the nominal mask itself; NaN without a decoder.
    error: float  #: Relative L2 error of any PSF.
    smallest_arm_um: float = 0.0  #: A main lobe nearer to the image point than this has no direction.
    ideal_peak: float = math.nan  #: See :attr:`MaskOptics.ideal_peak`.

    @classmethod
    def of(cls, optics: MaskOptics, pupils: Sequence[Pupil], error: float) -> Reference:
        """Compute the reference from the blocks of the nominal mask."""
        nominal = optics.light(pupils)
        decoder = DepthDecoder.of(optics, pupils) if optics.is_pair else None
        decoded_m = np.full(len(optics.depths_m), math.nan) if decoder is None else decoder.depth_m(nominal.pair)
        imaging = optics.window.imaging
        arm_um = _ARM * imaging.wavelength_um / imaging.numerical_aperture
        return cls(nominal, optics.depths_m, decoder, decoded_m, error, arm_um, optics.ideal_peak)

    def row(self, name: str, lights: Sequence[Light], relative_error: float) -> ToleranceRow:
        """Return the row of one mask, or of several draws of a random fault (rms or mean over the draws)."""
        rows = [self._row(name, light, relative_error) for light in lights]
        if len(rows) == 1:
            return rows[0]
        mean = {key: float(np.mean([getattr(row, key) for row in rows])) for key in _MEAN_OVER_DRAWS}
        rms = {key: float(np.sqrt(np.mean([getattr(row, key) ** 2 for row in rows]))) for key in _RMS_OVER_DRAWS}
        return replace(rows[0], **mean, **rms, below_error=rms["change"] <= self.error)  # type: ignore[arg-type]

    def _row(self, name: str, light: Light, relative_error: float) -> ToleranceRow:
        before, after = self.nominal, light
        n_depth, finite = len(self.depths_m), np.isfinite(self.depths_m)
        depth_error_m = self.decoded_m if self.decoder is None else self.decoder.depth_m(after.pair) - self.decoded_m
        arms_um = [math.hypot(*main_lobe_px(image)[:2]) * before.pixel_um for image in before.pair[0]]
        turn = (orientation_deg(after.pair[0]) - orientation_deg(before.pair[0]) + 180.0) % 360.0 - 180.0
        change = max(relative_l2(after.pair[p, d], before.pair[p, d]) for p in (0, 1) for d in range(n_depth))
        return ToleranceRow(
            name,
            change,
            peak_ratio=float((_peaks(after.pair) / _peaks(before.pair)).min()),
            efficiency=float(after.efficiency.min()),
            efficiency_change=_largest(after.efficiency - before.efficiency),
            extinction_ratio=float(after.extinction.min()),
            turn_deg=_largest(np.where(np.array(arms_um) >= self.smallest_arm_um, turn, math.nan)),
            depth_error_m=_largest(depth_error_m[finite]) if finite.any() else math.nan,
            relative_error=relative_error,
            below_error=change <= self.error,
            fwhm_x_um=after.spot[0],
            fwhm_y_um=after.spot[1],
            strehl=after.spot[2] / self.ideal_peak,
        )


def _peaks(pair: FloatArray) -> FloatArray:
    return np.array([[main_lobe_px(image)[2] for image in stack] for stack in pair])


def _largest(values: FloatArray) -> float:
    """The signed value of the largest modulus; NaN if any is."""
    flat = np.asarray(values).ravel()
    return float("nan") if np.isnan(flat).any() else float(flat[int(np.argmax(np.abs(flat)))])


def tolerance_table(
    written: WrittenField,
    library: Library,
    imaging: Imaging,
    depths_m: Sequence[float],
    tolerances: Tolerances,
    field_sites: int,
    numerics: PsfNumerics = PsfNumerics(),
    *,
    made: Sequence[CornerField] = (),
    transmission: Transmission | None = None,
    lens: LensFocus | None = None,
    work: Work = Work(workers=1),
) -> ToleranceTable:
    """Compare the PSFs at the corners of a written mask with those of the nominal mask, on the axis.

    Args:
        written: mask with the amplitudes of the library.
        depths_m: shape (n_depth,), object depths, ascending.
        tolerances: deviations of the fabrication; zeros leave corners out.
        field_sites: sites along a side of a write field.
        numerics: window, target error and filter of every PSF. Unwanted light is that of the design wavelength.
        made: the mask as processes make it, for the first rows of the table.
        transmission: stop or amplitude in the plane of the pillars; None for none.
        lens: focus whose widths and Strehl ratio the rows hold; None for devices without one.
        work: processes or cluster that solve cells, and progress over the corners. The result does not depend on them.

    Raises:
        InputError: slopes of rings or in a hexagonal lattice, inputs for which no PSF stack exists
            (:func:`metafab.optics.psf`), or write fields that for stitching must be divided into more blocks than fit
            into memory.
    """
    cell = library.unit_cell.cell
    if (cell.is_hexagonal or cell.shape == "ring") and tolerances.sidewall_deg > 0.0:
        kind = "a hexagonal lattice" if cell.is_hexagonal else 'cells of the shape "ring"'
        expected, remedy = f"0 for {kind}, whose slopes are not available", "set it in `[tolerance]`"
        raise InputError.single("tolerance", "sidewall_deg", expected, f"{tolerances.sidewall_deg:g}", remedy)
    with one_blas_thread():
        optics, pupils, error = MaskOptics.of(written, imaging, depths_m, numerics, transmission, work, lens)
        block = pupils[0].carrier.block_sites
        faults = _faults(tolerances, imaging, written, field_sites)
        require_block_memory(faults, written, block)
        reference = Reference.of(optics, pupils, error)
        with work.processes() as executor:
            corners = [*made]
            corners += corner_fields(
                written, library, _deviations(tolerances), executor=executor, progress=work.progress
            )
        rows = []
        for done, corner in enumerate(corners):
            row = reference.row(corner.name, [optics.light(optics.sums(corner.field))], corner.relative_error)
            rows.append(replace(row, solved=corner.solved))
            work.progress("tolerance", done + 1, len(corners))
        rows += [_fault_row(fault, reference, optics, pupils, written, tolerances.draws) for fault in faults]
    nominal = reference.row("nominal", [reference.nominal], 0.0)
    return ToleranceTable(np.array(optics.depths_m), error, block, nominal, tuple(rows))


def _deviations(tolerances: Tolerances) -> dict[str, float]:
    """Deviation of each axis of the cell that has one."""
    by_axis = {
        "cd_bias_nm": tolerances.cd_bias_nm,
        "height_nm": tolerances.height_nm,
        "sidewall_angle_deg": tolerances.sidewall_deg,
        "pillar_n_shift": tolerances.pillar_n,
    }
    return {axis: deviation for axis, deviation in by_axis.items() if deviation > 0.0}


def _faults(tolerances: Tolerances, imaging: Imaging, written: WrittenField, field_sites: int) -> list[Fault]:
    faults: list[Fault] = []
    if tolerances.misplacement_nm > 0.0:
        faults.append(Misplaced(imaging, tolerances.misplacement_nm))
    # Nothing is stitched where one field holds the whole lens.
    if tolerances.stitching_nm > 0.0 and max(written.lattice.shape) > field_sites:
        faults.append(Stitched(imaging, tolerances.stitching_nm, field_sites, written.lattice))
    if tolerances.missing_share > 0.0:
        faults.append(Missing(tolerances.missing_share))
    return faults


def require_block_memory(
    faults: Sequence[Fault], written: WrittenField, block_sites: int, most_blocks: int = MOST_BLOCKS
) -> None:
    """Refuse write fields that must be divided into more blocks than fit into memory, before any corner is solved.

    A block of a random fault divides the write field; ``block_sites`` are those along a side of a block without faults.
    InputError if the smaller blocks do not fit into memory.
    """
    for fault in faults:
        block = fault.block_sites(block_sites)
        if block < block_sites:
            require_memory(
                written,
                block,
                "mask.write_field_um",
                f"write fields of another number of sites, best a multiple of {block_sites},",
                "change the write field by a few sites, or leave stitching out: `tolerance.stitching_nm` = 0",
                most_blocks,
            )


def _fault_row(
    fault: Fault, reference: Reference, optics: MaskOptics, pupils: Sequence[Pupil], written: WrittenField, draws: int
) -> ToleranceRow:
    """The row of a random fault, over ``draws`` masks; the relative error of an rms over n draws is 1 / sqrt(2 n)."""
    block = fault.block_sites(pupils[0].carrier.block_sites)
    if block != pupils[0].carrier.block_sites:
        optics = optics.with_blocks(block)
        pupils = optics.sums(written)
        reference = replace(reference, nominal=optics.light(pupils))
    lights = [optics.light(fault(pupils, np.random.default_rng((draw, 1)))) for draw in range(draws)]
    return replace(reference.row(fault.name, lights, float(1.0 / np.sqrt(2.0 * draws))), draws=draws)


def save_tolerance(table: ToleranceTable, path: Path, *, mask_sha256: str) -> None:
    """Write the table with the hash of its mask; NaN becomes null."""
    write_json(path, {"kind": KIND, "format_version": FORMAT, "mask_sha256": mask_sha256, **vars(table)})


def load_tolerance(path: Path) -> tuple[ToleranceTable, str] | None:
    """Return the table and the hash of its mask; None if the file is missing, damaged or of another kind."""
    return read_json(path, KIND, FORMAT, _table)


def _table(content: dict[str, Any]) -> tuple[ToleranceTable, str]:
    return typed(ToleranceTable, content), str(content["mask_sha256"])
