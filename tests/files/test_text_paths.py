"""Results are saved to paths that are texts as to those of pathlib, as they are loaded."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from metafab import camera, decode, library, optics, phase
from metafab.library import Library
from metafab.spec import Design
from tests.closed_form_run import turning_psf
from tests.conftest import MainJob


def test_every_result_is_saved_to_a_path_that_is_a_text(
    main_job: MainJob, small_design: Design, smooth_library: Library, tmp_path: Path
) -> None:
    frame, image = camera.load(main_job.folder / "raw.h5"), decode.load(main_job.folder / "decoded.h5")
    optics.save(turning_psf(), str(tmp_path / "psf.h5"))
    camera.save(frame, str(tmp_path / "raw.h5"))
    decode.save(image, str(tmp_path / "decoded.h5"))
    library.save(smooth_library, str(tmp_path / "library.h5"))
    phase.save(phase.PhaseProfile(()), small_design, str(tmp_path / "phase.h5"), samples=3)
    assert np.array_equal(optics.load(str(tmp_path / "psf.h5")).psf, turning_psf().psf)
    assert np.array_equal(camera.load(str(tmp_path / "raw.h5")).frame, frame.frame)
    assert np.array_equal(decode.load(str(tmp_path / "decoded.h5")).depth_m, image.depth_m, equal_nan=True)
    assert np.array_equal(library.load(str(tmp_path / "library.h5")).t_xx, smooth_library.t_xx)
    assert phase.load(str(tmp_path / "phase.h5"))[0].size == 3
