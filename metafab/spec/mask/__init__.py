"""Mask of a design, and the process that prints it.

- ``files``    Mask: formats, layers, units, bias, tone; Exposure
- ``chip``     Dose, Chip, Copy, Include: what stands around and beside a lens
- ``kit``      Kit: test structures
- ``process``  Process: beam and etch
"""

from metafab.spec.mask.chip import Chip, Copy, Dose, Include
from metafab.spec.mask.files import MOST_DATATYPES, Exposure, Mask
from metafab.spec.mask.kit import CdBars, Grating, Kit, Overlay, Vernier
from metafab.spec.mask.process import BeamTerm, Etch, ExposureProcess, Process

__all__ = [
    "MOST_DATATYPES",
    "BeamTerm",
    "CdBars",
    "Chip",
    "Copy",
    "Dose",
    "Etch",
    "Exposure",
    "ExposureProcess",
    "Grating",
    "Include",
    "Kit",
    "Mask",
    "Overlay",
    "Process",
    "Vernier",
]
