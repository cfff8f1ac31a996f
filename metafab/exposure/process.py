"""Point-spread function of the beam for the ``[process.exposure]`` of a design."""

from __future__ import annotations

import numpy as np

from metafab.core.errors import InputError
from metafab.exposure.beam import BeamPsf, BeamTerm
from metafab.exposure.presets import preset
from metafab.spec.mask import ExposureProcess


def beam_psf(process: ExposureProcess) -> BeamPsf:
    """Build the function from a preset, terms or a table, with the process' blur.

    Raises:
        InputError: an unknown preset, or an unreadable table.
    """
    if process.preset is not None:
        plain = preset(process.preset)
    elif process.terms:
        terms = [BeamTerm(term.kind, term.weight, term.range_nm, term.exponent or 0.0) for term in process.terms]
        plain = BeamPsf.of(terms, process.source)
    else:
        plain = _from_table(process)
    return plain.blurred(process.blur_nm)


def _from_table(process: ExposureProcess) -> BeamPsf:
    """Fit Gaussians to the table of a CSV file."""
    path = process.table_file
    assert path is not None
    try:
        rows = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
        radius_nm, density = rows[:, 0], rows[:, 1]
    except (OSError, ValueError, IndexError) as error:
        expected = "a CSV file with a header line and the columns radius_nm, energy density"
        raise InputError.single(str(path), "table_file", expected, f"{error}") from error
    return BeamPsf.fitted(radius_nm, density, process.source)
