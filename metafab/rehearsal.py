"""A small lens from unit cell to depth map: shows that a machine can do it, and compiles every kernel on the way."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from metafab.core.parallel.progress import Progress, silent

#: The paper's cell, sampled as coarsely as a lens can be mapped from.
_UNIT_CELL = """
[cell]
period_nm = 350.0
height_nm = 600.0
shape = "rectangle"
[materials]
pillar = { n = 3.6941, k = 0.0065 }
substrate = { n = 1.7601 }
ambient = { n = 1.0 }
[illumination]
wavelength_nm = 800.0
side = "substrate"
[sweep]
width_nm = [100.0, 250.0]
length_nm = [100.0, 250.0]
size_grid_nm = 10.0
target_error = 0.05
"""
#: Depths of the sample scene are off by less than this, as a mean over its objects: a tenth of their range.
_PASSES = 0.03


@dataclass(frozen=True)
class Rehearsal:
    """What came of it.

    Attributes:
        nmae: mean |dz| / z of the decoded objects.
        violations: of the written mask, all rules together.
    """

    nmae: float
    violations: int

    @property
    def passed(self) -> bool:
        """Whether the mask keeps its rules and the depths are those of the scene."""
        return self.violations == 0 and self.nmae < _PASSES


def rehearse(progress: Progress = silent) -> Rehearsal:
    """Take the sample camera of ``metafab new`` through all steps, in a folder that is gone afterwards."""
    from metafab.run import run
    from metafab.spec import load_design
    from metafab.spec.new import write_new

    with TemporaryDirectory(prefix="metafab-") as name:
        folder = Path(name)
        unit_cell = folder / "cell.toml"
        unit_cell.write_text(_UNIT_CELL, encoding="utf-8")
        design, *_ = write_new("rehearsal", "camera", folder, library=unit_cell)
        summary = run(load_design(design), folder / "run", progress=progress).summary
    return Rehearsal(float(summary["decode"]["nmae"]), sum(summary["drc"]["violations"].values()))
