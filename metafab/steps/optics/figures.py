"""Figures of a PSF pair, for the summary, the report and the command line."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.storage.files import plain
from metafab.core.storage.tables import optional, typed

if TYPE_CHECKING:
    from metafab.optics import Psf
    from metafab.optics.measures.landing import Places

#: Share of the transmitted light in a window below which there is a warning, percent.
_LEAST_HELD_PERCENT = 2.0
#: Error of the amplitudes of made pillars above which there is a warning. Corners of silicon reach 0.06.
_LARGEST_MADE_ERROR = 0.15
#: Share of the aperture's sites without a pillar above which there is a warning: a design fills all of them.
_MOST_EMPTY = 0.01
#: Remedies of a window that does not hold the light. A design refuses the key where windows follow images of objects.
_WIDEN = "Widen the window with `verify.window_px` (`metafab psf --window-px N`)"
_MOVE = (
    "move it with `metafab psf --centre-um X Y` or, in a design without scene and `split_lens`, with "
    "`verify.centre_um = [x, y]`"
)


@dataclass(frozen=True, kw_only=True)
class PairFigures:
    """Figures of a PSF pair over depth, and the power budget at its middle depth."""

    depth_m: tuple[float, ...]  #: Object depths; the next five hold one value for each of them.
    phi_deg: tuple[float, ...]  #: Orientation of the main lobe of PSF_x, degrees counter-clockwise from +x.
    #: Share of the power at the aperture in the window of PSF_x; likewise ``efficiency_y``.
    efficiency_x: tuple[float, ...]
    efficiency_y: tuple[float, ...]
    extinction_ratio: tuple[float, ...]  #: Wanted over unwanted power in the window of PSF_x.
    error: tuple[float, ...]  #: Relative L2 error of the PSFs.
    #: Share of y polarised power that a birefringent substrate brings into the window of PSF_x, one value for each
    #: depth; likewise ``ghost_y``. None without such a substrate.
    ghost_x: tuple[float, ...] | None = optional()
    ghost_y: tuple[float, ...] | None = optional()
    #: Share of the power at the aperture that the mask transmits; ``stray_x``: transmitted share outside the window;
    #: ``lost_x``: share not transmitted. Likewise for y; None for a pair without a budget.
    transmitted_x: float | None = optional()
    stray_x: float | None = optional()
    lost_x: float | None = optional()
    transmitted_y: float | None = optional()
    stray_y: float | None = optional()
    lost_y: float | None = optional()
    #: (x, y) on the sensor, from the axis, of the brightest place of x and of y polarised light; None where the windows
    #: hold the light.
    light_at_um: tuple[tuple[float, ...], ...] | None = optional()
    #: True where the brightest pixel of a polarisation lies on the edge of its window, else None.
    peak_on_edge: bool | None = optional()
    #: Rms error of the amplitudes of made pillars over their rms, not part of ``error``; None for pillars of the file.
    made_error: float | None = optional()
    #: Sentence about a model of neighbours that gave the light and is not known to lower the error; None for others.
    neighbour_warning: str | None = optional()
    #: Share of the sites of the design's aperture at which the file has no pillar; None without a file.
    empty_share: float | None = optional()

    @classmethod
    def of(cls, psf: Psf, light_at_um: Places | None = None) -> PairFigures:
        """Figures of all depths of a pair."""
        table = {**_over_depth(psf, np.ones(psf.depth_m.size, dtype=bool)), **plain(psf.details.figures())}
        return replace(typed(cls, table), light_at_um=light_at_um, peak_on_edge=_on_edge(psf))

    @property
    def is_whole(self) -> bool:
        """Whether the windows hold the maxima of the light, as far as is known."""
        return self.light_at_um is None and not self.peak_on_edge

    def warnings(self) -> list[str]:
        """Return sentences on sites without pillars, a window that misses the light, made pillars and neighbours."""
        neighbours = [] if self.neighbour_warning is None else [self.neighbour_warning]
        return [*self._of_empty_sites(), *self._of_window(), *self._of_made_pillars(), *neighbours]

    def _of_empty_sites(self) -> list[str]:
        """A sentence on a file that holds another lens than the design's, or a part of it."""
        if self.empty_share is None or not self.empty_share > _MOST_EMPTY:
            return []
        return [
            f"{100.0 * self.empty_share:.3g} % of the sites in the design's aperture have no pillar in this file, and "
            "count as dark. Is it the mask of this design? `metafab drc` lists the sites"
        ]

    def _of_made_pillars(self) -> list[str]:
        """A sentence on made pillars whose light is hardly known."""
        if self.made_error is None or not self.made_error > _LARGEST_MADE_ERROR:
            return []
        return [
            f"the amplitudes of the made pillars are known to {100.0 * self.made_error:.2g} % (rms): some lie between "
            "solved sizes and beside resonances. Efficiencies may be off by about as much"
        ]

    def _of_window(self) -> list[str]:
        if self.light_at_um is None:
            return self._spread() if self.is_whole else [self._cut()]
        (x, y), (x_2, y_2) = self.light_at_um
        place = f"({x:.4g}, {y:.4g})" if (x, y) == (x_2, y_2) else f"({x:.4g}, {y:.4g}) and ({x_2:.4g}, {y_2:.4g})"
        return [
            f"the window misses the light: most of it lands about {place} um from the axis (x and y polarisation). "
            f"{_WIDEN}, or {_MOVE}"
        ]

    @property
    def _held_percent(self) -> float | None:
        """Least share of the transmitted light that a window holds at the middle depth; None if it is not known."""
        middle = len(self.depth_m) // 2
        shares = [
            100.0 * efficiency[middle] / transmitted
            for efficiency, transmitted in (
                (self.efficiency_x, self.transmitted_x),
                (self.efficiency_y, self.transmitted_y),
            )
            if transmitted
        ]
        return min(shares, default=None)

    def _spread(self) -> list[str]:
        """A sentence on a window that is far smaller than the spot."""
        if (held := self._held_percent) is None or held >= _LEAST_HELD_PERCENT:
            return []
        return [
            f"the window holds {held:.2g} % of the transmitted light: the spot is wider, or the light goes to many "
            f"places. Are focal length and sensor's focus as meant? {_WIDEN}"
        ]

    def _cut(self) -> str:
        held = (
            "" if self._held_percent is None else f", which holds {self._held_percent:.2g} % of the transmitted light"
        )
        return (
            f"the brightest pixel lies on the edge of the window{held}: lobe, widths and shares are those of a part of "
            f"the image. {_WIDEN}, or {_MOVE}"
        )


@dataclass(frozen=True, kw_only=True)
class PsfFigures(PairFigures):
    """Figures of the pair of a run at the verified depths, compared with the target phases."""

    #: Relative L2 error of PSFs interpolated over depth; None where no verified depth lies between other depths.
    depth_interpolation_error: float | None
    #: Relative L2 error of PSFs interpolated over the field; None without a field.
    field_interpolation_error: float | None
    depths: int  #: Number of depths of the stored pair.
    #: Lattice sites along the side of a block of the pupil; ``blocks``: number of blocks. These and the following are
    #: None for a pair that was not computed by :func:`metafab.optics.psf`.
    block_sites: float | None = optional()
    blocks: float | None = optional()
    field_error: float | None = optional()  #: Relative L2 error of the PSFs over the field; NaN without a field.
    #: This and the other names that begin with ``ideal_`` are the figures of the target phases, one value for each
    #: depth; None without a mask, where the pair itself is that of the target phases.
    ideal_phi_deg: tuple[float, ...] | None = optional()
    ideal_efficiency_x: tuple[float, ...] | None = optional()
    ideal_efficiency_y: tuple[float, ...] | None = optional()
    ideal_extinction_ratio: tuple[float, ...] | None = optional()
    ideal_error: tuple[float, ...] | None = optional()
    filter_fwhm_nm: float | None = optional()  #: Width of the colour filter; None for one wavelength.
    #: True where the library's model of unlike neighbours gave the light of the pillars, else None.
    with_neighbours: bool | None = optional()
    #: Joint effect of rows and columns in windows of the mask, relative rms of the field, which the light by that model
    #: leaves out; None for other light, and where it was not solved.
    joint_error: float | None = optional()
    #: Relative rms error of the pillars' light from the corner of the field, which comes at an angle: its change, or
    #: what ``[optics] oblique`` leaves of it. None without a field, and where it was not solved
    #: (:func:`metafab.library.use.oblique.oblique_field_error`).
    oblique_error: float | None = optional()
    oblique_change: float | None = optional()  #: The change itself where the PSFs carry it, else None.

    @classmethod
    def compared(
        cls,
        psf: Psf,
        ideal: Psf | None,
        *,
        verified: NDArray[np.bool_],
        depth_interpolation_error: float | None = None,
        light_at_um: Places | None = None,
    ) -> PsfFigures:
        """Figures of a pair and of the target phases (None without a mask) at the verified depths.

        ``verified``, shape (n_depth,), marks these among the depths of ``psf``.
        """
        of_target = {} if ideal is None else _over_depth(ideal, np.ones(ideal.depth_m.size, dtype=bool), "ideal_")
        table = {
            **_over_depth(psf, verified),
            **of_target,
            "depth_interpolation_error": depth_interpolation_error,
            "field_interpolation_error": None,  # until the details say more
            "depths": psf.depth_m.size,
            **plain(psf.details.figures()),
        }
        return replace(typed(cls, table), light_at_um=light_at_um, peak_on_edge=_on_edge(psf))


def _on_edge(psf: Psf) -> bool | None:
    from metafab.optics.measures.metrics import peak_on_edge

    return peak_on_edge(psf) or None


def _over_depth(psf: Psf, chosen: NDArray[np.bool_], prefix: str = "") -> dict[str, list[float]]:
    """Table of the figures over depth, at the chosen depths."""
    columns: dict[str, FloatArray] = {
        "depth_m": psf.depth_m,
        "phi_deg": psf.phi_deg,
        "efficiency_x": psf.efficiency[0],
        "efficiency_y": psf.efficiency[1],
        "extinction_ratio": psf.extinction_ratio,
        "error": psf.error,
    }
    if psf.ghost is not None and not prefix:
        columns |= {"ghost_x": psf.ghost.efficiency[0], "ghost_y": psf.ghost.efficiency[1]}
    return {prefix + name: values[chosen].tolist() for name, values in columns.items()}
