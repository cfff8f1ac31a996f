"""Camera: a scene and the PSF pair -> a raw frame (Eq. 1 of Shen 2023, occlusion, noise); frames of real cameras.

- ``geometry``    directions to places on the sensor and back, for both polarisations: Psf -> ImageMap
- ``kernels``     blur kernels at any depth and direction: Psf -> PairKernels
- ``rendering/``  a scene at rest -> mean electrons of each pixel
- ``capture``     Scene and Psf -> RawFrame, or the RawFrames of a film; the sensor's noise, full wells and counts
- ``exact``       the PSFs of one scene's own depths, field and light: Scene -> Psf
- ``stokes``      a scene of known polarisation as six images: Scene and StokesPsf -> StokesFrame
- ``frames/``     RawFrame and its truth; raw.h5, batches of frames, TIFF, PNG and NumPy files
"""

from metafab.camera.capture import batch as batch
from metafab.camera.capture import capture, draws, film
from metafab.camera.capture import require_fit as require_fit
from metafab.camera.exact import exact_psf
from metafab.camera.frames.batch import Draw as Draw
from metafab.camera.frames.batch import load_draw, save_batch
from metafab.camera.frames.foreign import (
    Counts,
    load_frame,
    save_counts,
)
from metafab.camera.frames.foreign import counts_of as counts_of
from metafab.camera.frames.foreign import require_frame_name as require_frame_name
from metafab.camera.frames.frame import RawFrame, Truth, load, save
from metafab.camera.geometry import ImageMap as ImageMap
from metafab.camera.kernels import PairKernels as PairKernels

__all__ = [
    "capture",
    "film",
    "draws",
    "RawFrame",
    "Truth",
    "exact_psf",
    "load",
    "save",
    "load_frame",
    "save_counts",
    "Counts",
    "save_batch",
    "load_draw",
]
