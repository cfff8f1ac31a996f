"""Random faults of a mask as changes of its block sums: misplaced pillars, stitched write fields, missing pillars.

A block adds up N sites with independent faults. Its sum S keeps a damped mean and scatters in two parts: in step with
S, by S / sqrt(N) times one Gaussian number that both polarisations share; and independently of S, circular Gaussian,
such that the variances add up to those of the sites. Moments scatter likewise, over the extent of a block.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.layout.pillars import Lattice
from metafab.optics.geometry.imaging import Imaging
from metafab.optics.geometry.path import path_and_slopes
from metafab.optics.propagation.pupil import Pupil


class Fault(ABC):
    """Random fault of fabrication."""

    @property
    @abstractmethod
    def name(self) -> str:
        """Kind and size of the fault."""

    def block_sites(self, largest: int) -> int:
        """Return the largest valid number of sites along a side of a block, ``largest`` at most."""
        return largest

    @abstractmethod
    def __call__(self, pupils: Sequence[Pupil], random: np.random.Generator) -> list[Pupil]:
        """Return the blocks of one faulty mask; the blocks of all carriers belong to the same mask."""


@dataclass(frozen=True)
class Misplaced(Fault):
    """Each pillar displaced independently, normal distribution."""

    imaging: Imaging  #: Geometry.
    rms_nm: float  #: Standard deviation along x and along y.

    @property
    def name(self) -> str:
        """Kind and size of the fault."""
        return f"misplacement {self.rms_nm:g} nm rms"

    def __call__(self, pupils: Sequence[Pupil], random: np.random.Generator) -> list[Pupil]:
        """Return the blocks of displaced pillars."""
        shared: dict[tuple[int, ...], FloatArray] = {}
        displaced = []
        for pupil in pupils:
            slopes = self.imaging.wavenumber * 1e-3 * self.rms_nm * _slopes(pupil)
            common = shared.setdefault(pupil.power.shape, random.normal(size=(3, 2, *pupil.power.shape)))
            in_step = 1j * np.einsum("oayx,ayx->oyx", common, slopes)
            square = np.sum(slopes**2, axis=0)
            variance = 1.0 - np.exp(-square)
            mean = np.sqrt(1.0 - variance)
            displaced.append(_scattered(pupil, mean, in_step * mean, variance, square * mean**2, random))
        return displaced


@dataclass(frozen=True)
class Missing(Fault):
    """A random share of the pillars is missing."""

    share: float  #: Probability that a pillar is missing, 0 to 1.

    @property
    def name(self) -> str:
        """Kind and size of the fault."""
        return f"missing {1e3 * self.share:g} per mille"

    def __call__(self, pupils: Sequence[Pupil], random: np.random.Generator) -> list[Pupil]:
        """Return the blocks without the missing pillars."""
        shared: dict[tuple[int, ...], FloatArray] = {}
        thinned = []
        variance = self.share * (1.0 - self.share)
        for pupil in pupils:
            common = shared.setdefault(pupil.power.shape, random.normal(size=(3, *pupil.power.shape)))
            mean, scatter = np.full(pupil.power.shape, 1.0 - self.share), np.full(pupil.power.shape, variance)
            found = _scattered(pupil, mean, np.sqrt(variance) * common + 0j, scatter, scatter, random)
            thinned.append(replace(found, power=mean * pupil.power))
        return thinned


@dataclass(frozen=True)
class Stitched(Fault):
    """Each write field displaced as a whole, normal distribution."""

    imaging: Imaging  #: Geometry.
    rms_nm: float  #: Standard deviation along x and along y.
    field_sites: int  #: Sites along a side of a write field.
    lattice: Lattice  #: Sites of the mask.

    @property
    def name(self) -> str:
        """Kind and size of the fault."""
        return f"stitching {self.rms_nm:g} nm rms"

    def block_sites(self, largest: int) -> int:
        """Return the largest divisor of a write field, so that each block lies in one field."""
        return max(b for b in range(1, largest + 1) if self.field_sites % b == 0)

    def __call__(self, pupils: Sequence[Pupil], random: np.random.Generator) -> list[Pupil]:
        """Return the blocks of displaced fields; all sites of a block share the offset of their field."""
        fields = [-(-count // self.field_sites) for count in self.lattice.shape]
        offset_um = random.normal(scale=1e-3 * self.rms_nm, size=(2, *fields))
        stitched = []
        for pupil in pupils:
            per_field = self.field_sites // pupil.carrier.block_sites
            row, column = (np.arange(count) // per_field for count in pupil.power.shape)
            d_x, d_y = offset_um[:, row[:, None], column[None, :]]
            ray, x, y = pupil.carrier.ray, pupil.x_um[None, :], pupil.y_um[:, None]
            change_um = ray.path_um(x + d_x, y + d_y) - ray.path_um(x, y)
            sums = pupil.sums * np.exp(1j * self.imaging.wavenumber * change_um)
            stitched.append(replace(pupil, sums=sums))
        return stitched


def _slopes(pupil: Pupil) -> FloatArray:
    """Slopes of the path along x and y at the block centres, shape (2, n_y, n_x)."""
    _, along_x, along_y = path_and_slopes(pupil.x_um[None, :], pupil.y_um[:, None], pupil.carrier.ray.numbers)
    return np.array(np.broadcast_arrays(along_x, along_y))


def _scattered(
    pupil: Pupil,
    mean: FloatArray,
    in_step: ComplexArray,
    variance: FloatArray,
    in_step_variance: FloatArray,
    random: np.random.Generator,
) -> Pupil:
    """Damp and scatter blocks.

    Args:
        mean: shape (n_y, n_x), mean of a site's random factor.
        in_step: shape (3, n_y, n_x), scatter in step with S in units of S / sqrt(N), of the sum and the moments.
        variance: shape (n_y, n_x), variance of a site's random factor.
        in_step_variance: shape (n_y, n_x), variance of ``in_step``.
        random: draws the independent scatter.
    """
    sites = float(pupil.carrier.block_sites**2)
    spread = (1.0, *pupil.spread_um2)
    total = pupil.sums[0]
    rest = np.maximum(pupil.power * variance - np.abs(total) ** 2 / sites * in_step_variance, 0.0)
    circular = random.normal(scale=np.sqrt(0.5), size=(3, 2, *total.shape))
    sums = []
    for part, width, step, (real, imag) in zip(pupil.sums, spread, in_step, circular, strict=True):
        scatter = total / np.sqrt(sites) * step + np.sqrt(rest) * (real + 1j * imag)
        sums.append(mean * part + np.sqrt(width) * scatter)
    return replace(pupil, sums=np.array(sums))
