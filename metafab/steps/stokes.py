"""The full-Stokes sibling of a camera design: mask file, PSFs of the file read back, a frame, and what it tells."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from metafab.core.errors import InputError
from metafab.core.storage.files import write_json
from metafab.steps.job import Job
from metafab.steps.library import open_library
from metafab.steps.optics import calibration_depths

if TYPE_CHECKING:
    from metafab.stokes import StokesFrame, StokesImage


def full_stokes(
    job: Job, *, row_angle_deg: float, angles: int, size_step_nm: float
) -> tuple[dict[str, Any], StokesFrame, StokesImage]:
    """Write ``stokes.oas`` (or .gds) and ``stokes.json``, and photograph and decode the design's scene.

    Raises:
        InputError: the design has no scene, or its gap leaves no room for turned pillars.
    """
    from metafab import stokes
    from metafab.layout import lattice_of
    from metafab.optics import Apodisation, Imaging
    from metafab.stokes import mask

    design = job.design
    if not design.has_mask:
        raise InputError.single(design.name, "mask.formats", "'gds', 'oas' or both", "none", "name one")
    if design.scene is None:
        raise InputError.single(design.name, "scene", "a scene to photograph", "none", "add a `[scene]` table")
    if Apodisation.of(design) is not None:
        raise InputError.single(
            design.name, "optics", "no stop or amplitude", "one", "full-Stokes PSFs do not know of them: leave them out"
        )
    if design.scene.exposure_s > 0.0 and any(piece.moves for piece in design.scene.objects):
        raise InputError.single(
            design.name, "scene.exposure_s", "0 s where objects move", f"{design.scene.exposure_s:g} s",
            "full-Stokes frames know no motion",
        )  # fmt: skip
    imaging, library = Imaging.of(design), open_library(job)
    profile = stokes.stokes_profile(design, row_angle_deg)
    pillars = stokes.assign(profile, library, design, angles=angles, size_step_nm=size_step_nm, progress=job.progress)
    job.folder.mkdir(parents=True, exist_ok=True)
    files = [mask.write(pillars, job.folder / f"stokes.{suffix}", design) for suffix in design.mask.formats]
    written = mask.read(files[-1], library, design, angles=angles)
    depths_m = calibration_depths(design, imaging)
    window_px = design.verify.window_px
    ideal = stokes.stokes_psf(
        stokes.UnitaryField(profile, lattice_of(design), design.device), profile, imaging, depths_m[:1],
        window_px=window_px,
    )  # fmt: skip
    psf = stokes.stokes_psf(written, profile, imaging, depths_m, window_px=window_px, progress=job.progress)
    frame = stokes.photograph(design.scene, psf)
    image = stokes.decode_stokes(frame, psf)
    own = np.einsum("kj,kj->k", psf.instrument, stokes.stokes_of(stokes.JONES))
    wrong = np.einsum("kj,kj->k", psf.instrument, stokes.stokes_of(stokes.JONES[[1, 0, 3, 2, 5, 4]]))
    figures = {
        "pillars": int((written.index > 0).sum()),
        "distinct": len(written.kinds),
        "angles": angles,
        "overlap": pillars.overlap,
        "states": stokes.STATES,
        "efficiency": own,
        "extinction_ratio": own / wrong,
        "ideal_efficiency": np.einsum("kj,kj->k", ideal.instrument, stokes.stokes_of(stokes.JONES)),
        "condition_number": float(np.linalg.cond(psf.instrument)),
        **stokes.stokes_errors(image, frame),
        "files": [{"name": path.name, "bytes": path.stat().st_size} for path in files],
    }
    write_json(job.folder / "stokes.json", figures)
    return figures, frame, image
