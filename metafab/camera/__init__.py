"""Scene and PSF pair -> raw frame (Eq. 1, occlusion, noise), and frames of real cameras.

- ``frame``     RawFrame and Truth
- ``geometry``  directions to places on the sensor and back, for both polarisations
- ``kernels``   the PSF calibration as blur kernels at any depth and direction
- ``texture``   procedural and pictured textures
- ``render``    objects to coverage and brightness at each depth
- ``motion``    where objects are when, and which rows see them then
- ``blur``      a layer through a PSF that varies over the field
- ``sensor``    noise, dark current, fixed pattern, full wells, counts
- ``windows``   where on the sensor the images lie, and what their pixels collect
- ``exact``     the PSFs of one scene's own depths, field and light
- ``capture``   all of it: one exposure, or the frames of a film
- ``quality``   how sharp a texture can be restored through some PSFs
- ``store``     raw.h5
- ``foreign``   TIFF, PNG and NumPy frames

In: a Scene and a Psf, or a file. Out: a RawFrame.
"""

from metafab.camera.capture import capture, film
from metafab.camera.exact import exact_psf
from metafab.camera.frames.foreign import Counts, counts_of, load_frame, require_frame_name, save_counts
from metafab.camera.frames.frame import RawFrame, Truth
from metafab.camera.frames.store import load, save
from metafab.camera.geometry import ImageMap
from metafab.camera.kernels import PairKernels

__all__ = [
    "Counts",
    "ImageMap",
    "PairKernels",
    "RawFrame",
    "Truth",
    "capture",
    "counts_of",
    "exact_psf",
    "film",
    "load",
    "load_frame",
    "require_frame_name",
    "save",
    "save_counts",
]
