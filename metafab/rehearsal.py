"""Rehearsal: a run of a small lens from unit cell to depth map, which also compiles every kernel."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from metafab.core.parallel.progress import Progress, silent
from metafab.core.parallel.work import Work

#: The unit cell of the paper, sampled as coarsely as a lens allows.
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
#: Largest mean relative depth error of a rehearsal that passes: a tenth of the scene's range of depths.
_LARGEST_ERROR = 0.03


@dataclass(frozen=True)
class Rehearsal:
    """Result of a rehearsal."""

    nmae: float  #: Mean |dz| / z over the decoded pixels.
    violations: int  #: Number of violations of all design rules.

    @property
    def passed(self) -> bool:
        """Whether the mask keeps the rules and the depths agree with the scene."""
        return self.violations == 0 and self.nmae < _LARGEST_ERROR


def rehearse(progress: Progress = silent) -> Rehearsal:
    """Run all steps for the sample camera of ``metafab new``, in a temporary folder."""
    from metafab.run import run
    from metafab.spec import load_design
    from metafab.spec.new import write_new

    with TemporaryDirectory(prefix="metafab-") as name:
        folder = Path(name)
        unit_cell = folder / "cell.toml"
        unit_cell.write_text(_UNIT_CELL, encoding="utf-8")
        design, *_ = write_new("rehearsal", "camera", folder, library=unit_cell)
        summary = run(load_design(design), folder / "run", work=Work(progress=progress))
    nmae = math.nan if summary.decode is None or summary.decode.nmae is None else summary.decode.nmae
    return Rehearsal(nmae, summary.violations)
