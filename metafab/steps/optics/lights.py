"""The written mask in each light of the design: its PSF pair and its focus at every wavelength and angle."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from metafab.core.figures import FocusFigures
from metafab.core.storage.tables import optional
from metafab.spec import Light
from metafab.spec.light import light_label
from metafab.steps.job import Job, Step, light_tangent, no_mask
from metafab.steps.layout import mask_paths
from metafab.steps.optics.figures import PairFigures
from metafab.steps.optics.merit import focus_figures
from metafab.steps.optics.pairs import pair_figures, point_spread, save_psf
from metafab.steps.optics.sources import WrittenLens


@dataclass(frozen=True)
class LightFigures:
    """The written mask in one light."""

    wavelength_nm: float  #: Vacuum wavelength.
    file: str  #: PSF pair of the written mask at the verified depths.
    pair: PairFigures  #: Its figures.
    ideal_efficiency_x: tuple[float, ...]  #: Efficiency of the target phases, for each depth; likewise y.
    ideal_efficiency_y: tuple[float, ...]
    focus: FocusFigures | None = optional()  #: The focus of a lens; None for other devices and at an angle.
    angle_x_deg: float = 0.0  #: Angle of incidence in the x-z plane, in the medium of incidence.
    angle_y_deg: float = 0.0  #: Likewise in the y-z plane.

    @property
    def label(self) -> str:
        """Wavelength and direction in words."""
        return light_label(self.wavelength_nm, self.angle_x_deg, self.angle_y_deg)


@dataclass(frozen=True)
class LightsFigures:
    """The written mask at every wavelength that it serves."""

    lights: tuple[LightFigures, ...]  #: In the order of the design.

    def warnings(self) -> list[str]:
        """Return a sentence for each light that misses the window."""
        return [f"at {each.label} {text}" for each in self.lights for text in each.pair.warnings()]


def _light_path(job: Job, light: Light) -> Path:
    angles = "".join(f"_{axis}{angle:.12g}deg" for axis, angle in zip("xy", light.key[1:], strict=True) if angle)
    return job.folder / f"psf_{light.wavelength_nm:.12g}nm{angles}.h5"


def _at_light(job: Job, light: Light) -> LightFigures:
    from metafab.optics import Imaging

    alone, mask_path = job.at_light(light), mask_paths(job)[-1]
    lens = WrittenLens(mask_path)
    tangent = light_tangent(alone.design, light) if light.angles_deg else None
    (written, light_at_um), (ideal, _) = (point_spread(alone, each, tangent=tangent) for each in (lens, None))
    save_psf(alone, written, lens, _light_path(job, light))
    is_focus = alone.design.is_lens and tangent is None
    return LightFigures(
        wavelength_nm=light.wavelength_nm,
        file=_light_path(job, light).name,
        pair=pair_figures(alone, written, light_at_um, lens),
        ideal_efficiency_x=tuple(ideal.efficiency[0].tolist()),
        ideal_efficiency_y=tuple(ideal.efficiency[1].tolist()),
        focus=focus_figures(alone, Imaging.of(alone.design), mask_path) if is_focus else None,
        angle_x_deg=light.angle_x_deg,
        angle_y_deg=light.angle_y_deg,
    )


LIGHTS = Step(
    name="lights",
    rooms=("mask", "library", "optics", "phase"),
    after=("library", "phase", "layout"),
    inputs=lambda d: (d.light, d.phase, d.device, d.sensor, d.verify, d.optics, d.substrate),
    outputs=lambda job: tuple(_light_path(job, light) for light in job.design.light),
    work=lambda job: LightsFigures(tuple(_at_light(job, light) for light in job.design.light)),
    figures=LightsFigures,
    not_needed=lambda design: no_mask(design) or (None if design.light else "the design serves one wavelength"),
)
