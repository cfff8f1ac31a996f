"""Random faults of a mask, as changes of its block sums: moved pillars, write fields aside, missing pillars.

A block adds up N sites that are faulty independently of each other. Its sum S keeps its mean, damped, and scatters: in
step with S by what the sites have in common, S / sqrt(N) times one Gaussian number of the block, the same for both
polarisations; and by what they have not, circular, so that the variances add up to those of the sites, P in all.
Moments scatter likewise, over the spread of a block. :mod:`metafab.tolerance.fabrication` moves each pillar by itself
and is what this is tested on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.layout.pillars import Lattice
from metafab.optics.geometry.imaging import Imaging
from metafab.optics.geometry.path import path_and_slopes
from metafab.optics.propagation.pupil import Pupil


class Fault(Protocol):
    """A random fault of fabrication."""

    @property
    def name(self) -> str:
        """What it is, and how large."""

    def block_sites(self, wanted: int) -> int:
        """Sites a side of the blocks that it can be applied to, ``wanted`` at most."""

    def __call__(self, pupils: Sequence[Pupil], random: np.random.Generator) -> list[Pupil]:
        """The blocks of one faulty mask; blocks of any carrier belong to the same mask."""


@dataclass(frozen=True)
class Misplaced:
    """Every pillar on its own aside, Gaussian, ``rms_nm`` along x and along y."""

    imaging: Imaging
    rms_nm: float

    @property
    def name(self) -> str:
        """What it is, and how large."""
        return f"misplacement {self.rms_nm:g} nm rms"

    def block_sites(self, wanted: int) -> int:
        """Any."""
        return wanted

    def __call__(self, pupils: Sequence[Pupil], random: np.random.Generator) -> list[Pupil]:
        """Blocks of pillars that stand aside."""
        shared: dict[tuple[int, ...], FloatArray] = {}
        moved = []
        for pupil in pupils:
            slopes = self.imaging.wavenumber * 1e-3 * self.rms_nm * _slopes(pupil)
            common = shared.setdefault(pupil.power.shape, random.normal(size=(3, 2, *pupil.power.shape)))
            in_step = 1j * np.einsum("oayx,ayx->oyx", common, slopes)
            variance = 1.0 - np.exp(-np.sum(slopes**2, axis=0))
            mean = np.sqrt(1.0 - variance)
            moved.append(_scattered(pupil, mean, in_step * mean, variance, np.sum(slopes**2, axis=0) * mean**2, random))
        return moved


@dataclass(frozen=True)
class Missing:
    """A share of the pillars, chosen at random, is not there."""

    share: float

    @property
    def name(self) -> str:
        """What it is, and how large."""
        return f"missing {1e3 * self.share:g} per mille"

    def block_sites(self, wanted: int) -> int:
        """Any."""
        return wanted

    def __call__(self, pupils: Sequence[Pupil], random: np.random.Generator) -> list[Pupil]:
        """Blocks without the lost pillars."""
        shared: dict[tuple[int, ...], FloatArray] = {}
        thinned = []
        variance = self.share * (1.0 - self.share)
        for pupil in pupils:
            common = shared.setdefault(pupil.power.shape, random.normal(size=(3, *pupil.power.shape)))
            mean, scatter = np.full(pupil.power.shape, 1.0 - self.share), np.full(pupil.power.shape, variance)
            thinned.append(_scattered(pupil, mean, np.sqrt(variance) * common + 0j, scatter, scatter, random))
        return thinned


@dataclass(frozen=True)
class Stitched:
    """Every write field as a whole aside, Gaussian, ``rms_nm`` along x and along y."""

    imaging: Imaging
    rms_nm: float
    field_sites: int
    lattice: Lattice

    @property
    def name(self) -> str:
        """What it is, and how large."""
        return f"stitching {self.rms_nm:g} nm rms"

    def block_sites(self, wanted: int) -> int:
        """The largest divisor of a field: blocks then lie in one."""
        return max(b for b in range(1, wanted + 1) if self.field_sites % b == 0)

    def __call__(self, pupils: Sequence[Pupil], random: np.random.Generator) -> list[Pupil]:
        """Blocks of fields that lie aside; a field's offset is the same for all sites of a block."""
        fields = [-(-count // self.field_sites) for count in self.lattice.shape]
        aside_um = random.normal(scale=1e-3 * self.rms_nm, size=(2, *fields))
        stitched = []
        for pupil in pupils:
            per_field = self.field_sites // pupil.carrier.block_sites
            row, column = (np.arange(count) // per_field for count in pupil.power.shape)
            d_x, d_y = aside_um[:, row[:, None], column[None, :]]
            ray, x, y = pupil.carrier.ray, pupil.x_um[None, :], pupil.y_um[:, None]
            change_um = ray.path_um(x + d_x, y + d_y) - ray.path_um(x, y)
            turned = pupil.sums * np.exp(1j * self.imaging.wavenumber * change_um)
            stitched.append(replace(pupil, sums=turned))
        return stitched


def _slopes(pupil: Pupil) -> FloatArray:
    """Slopes of the path along x and y at the blocks' centres, shape (2, n_y, n_x)."""
    ray = pupil.carrier.ray
    _, along_x, along_y = path_and_slopes(
        pupil.x_um[None, :], pupil.y_um[:, None], ray.vergence_per_um, *ray.tangent, *ray.target_um
    )
    return np.array(np.broadcast_arrays(along_x, along_y))


def _scattered(
    pupil: Pupil,
    mean: FloatArray,
    in_step: ComplexArray,
    variance: FloatArray,
    in_step_variance: FloatArray,
    random: np.random.Generator,
) -> Pupil:
    """Blocks damped by ``mean`` (n_y, n_x) and scattered.

    Args:
        pupil: the blocks.
        mean: of a site's factor.
        in_step: shape (3, n_y, n_x), what sites in step with each other add over S / sqrt(N), for sum and moments.
        variance: of a site's factor.
        in_step_variance: of ``in_step``.
        random: draws what is not in step.
    """
    block = pupil.carrier.block_sites
    sites = float(block * block)
    spread = [1.0] + [pitch * pitch * (block * block - 1) / 12.0 for pitch in pupil.pitch_um]
    total = pupil.sums[0]
    rest = np.maximum(pupil.power * variance - np.abs(total) ** 2 / sites * in_step_variance, 0.0)
    circular = random.normal(scale=np.sqrt(0.5), size=(3, 2, *total.shape))
    sums = [
        mean * part + np.sqrt(width) * (total / np.sqrt(sites) * step + np.sqrt(rest) * (own[0] + 1j * own[1]))
        for part, width, step, own in zip(pupil.sums, spread, in_step, circular, strict=True)
    ]
    return replace(pupil, sums=np.array(sums))
