"""Full-Stokes sibling of a camera design: six states of polarisation on six areas of the sensor, one mask, one frame.

- ``bases``   six states in three pairs, Stokes vectors
- ``target``  the sum of six lenses as one Jones matrix a site
- ``assign``  pillars of some sizes, turned by some angles, for it
- ``mask``    turned pillars as polygons in a file, and back
- ``spread``  PSFs of the six places over depth
- ``camera``  a scene as six images
- ``decode``  six images -> depth and Stokes vectors

In: a Design, a Library. Out: a mask file, a StokesPsf, a StokesImage.
"""

from metafab.stokes.assign import TurnedPillars, assign
from metafab.stokes.bases import JONES, STATES, response_of, stokes_of
from metafab.stokes.camera import StokesFrame, photograph
from metafab.stokes.decode import StokesImage, decode_stokes, stokes_errors
from metafab.stokes.spread import StokesPsf, UnitaryField, stokes_psf
from metafab.stokes.target import StokesProfile, nearest_unitary, places_um, stokes_profile

__all__ = [
    "JONES",
    "STATES",
    "StokesFrame",
    "StokesImage",
    "StokesProfile",
    "StokesPsf",
    "TurnedPillars",
    "UnitaryField",
    "assign",
    "decode_stokes",
    "nearest_unitary",
    "photograph",
    "places_um",
    "response_of",
    "stokes_errors",
    "stokes_of",
    "stokes_profile",
    "stokes_psf",
]
