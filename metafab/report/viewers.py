"""Data of the two live views of the page: PSF pair over depth, and decoded image with its values.

Pictures are palette PNGs, values deflated integers.
"""

from __future__ import annotations

import base64
import io
import zlib
from typing import Any

import matplotlib
import numpy as np
from matplotlib.colors import Colormap
from numpy.typing import NDArray
from PIL import Image

from metafab.core.conventions import FloatArray
from metafab.decode.image import Image4D
from metafab.optics.point_spread import Psf
from metafab.report.figures.image import contrast_reach
from metafab.report.figures.psf import lit_half_px
from metafab.report.style import CONTRAST_MAP, DEPTH_MAP, LIGHT_MAP, depth_text

#: Palette entry of pixels without a value, which is transparent.
_BLANK = 255
#: Integer that stands for NaN.
_NO_VALUE = 65535


def psf_view(psf: Psf, ideal: Psf | None, source: str = "written file", *, has_lobe: bool = True) -> dict[str, Any]:
    """Data of the PSF view: a strip of pictures over depth and their figures, for the pair and the target phases.

    ``source`` names the pair; ``has_lobe`` says whether the maximum is a lobe beside the image point, whose direction
    is shown.
    """
    views = [_psf_strip(source, psf, has_lobe)]
    if ideal is not None:
        views.append(_psf_strip("target phases", ideal, has_lobe))
    return {"views": views}


def _psf_strip(name: str, psf: Psf, has_lobe: bool) -> dict[str, Any]:
    centre_y, centre_x = (count // 2 for count in psf.psf.shape[2:])
    half = lit_half_px(psf)
    lit = psf.psf[:, :, centre_y - half : centre_y + half + 1, centre_x - half : centre_x + half + 1]
    _, n_depth, n_y, n_x = lit.shape
    brightest = float(psf.psf.max()) or 1.0
    levels = np.clip(np.rint(lit / brightest * 254.0), 0, 254).astype(np.uint8)
    strips = [np.flip(stack, axis=1).reshape(n_depth * n_y, n_x) for stack in levels]  # y up: first row on top
    peaks = lit.reshape(2, n_depth, -1).argmax(axis=2)
    row, column = np.unravel_index(peaks, (n_y, n_x))
    return {
        "name": name,
        "size": [n_x, n_y],
        "pixel_um": psf.pixel_um,
        "brightest": brightest,
        "depth": [depth_text(float(depth)) for depth in psf.depth_m],
        # A maximum on the image point has no direction.
        "phi_deg": [
            round(float(phi), 2) if has_lobe and (at != (n_y // 2) * n_x + n_x // 2).any() else None
            for phi, at in zip(psf.phi_deg, peaks.T, strict=True)
        ],
        "efficiency": np.round(psf.efficiency, 5).tolist(),
        "peak": (np.stack([column - n_x // 2, row - n_y // 2], axis=-1) * int(has_lobe)).tolist(),
        "strips": [_palette_png(strip, matplotlib.colormaps[LIGHT_MAP]) for strip in strips],
    }


def decoded_view(decoded: Image4D) -> dict[str, Any]:
    """Data of the image view: four pictures of the decoded image, and the values at each pixel."""
    both = np.concatenate([decoded.intensity_x.ravel(), decoded.intensity_y.ravel()])
    both = both[np.isfinite(both)]
    top = float(np.percentile(both, 99.8)) if both.size else 1.0
    known = decoded.depth_m[np.isfinite(decoded.depth_m)]
    near, far = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    reach = float(np.log(contrast_reach(decoded)))
    gray, depth_map = matplotlib.colormaps["gray"], matplotlib.colormaps[DEPTH_MAP]
    with np.errstate(divide="ignore", invalid="ignore"):
        log_contrast = np.log(decoded.contrast)
    span = (far - near) or 1.0
    pictures = [
        ("I_x", decoded.intensity_x / top, gray),
        ("I_y", decoded.intensity_y / top, gray),
        ("contrast", 0.5 + 0.5 * log_contrast / reach, CONTRAST_MAP),
        ("depth", (decoded.depth_m - near) / span, depth_map),
    ]
    values = {
        "intensity_x": decoded.intensity_x,
        "intensity_y": decoded.intensity_y,
        "contrast": decoded.contrast,
        "depth_m": decoded.depth_m,
        "confidence": decoded.confidence,
    }
    n_y, n_x = decoded.depth_m.shape
    return {
        "size": [n_x, n_y],
        "origin_um": list(decoded.origin_um),
        "pixel_um": decoded.pixel_um,
        "pictures": [{"name": n, "png": _palette_png(_levels(share), colours)} for n, share, colours in pictures],
        "values": {name: _deflated(array) for name, array in values.items()},
    }


def _levels(share: FloatArray) -> NDArray[np.uint8]:
    """Palette entries of values from 0 to 1, first row on top; NaN becomes the blank entry."""
    entries = np.full(share.shape, _BLANK, dtype=np.uint8)
    known = np.isfinite(share)
    entries[known] = np.clip(np.rint(share[known] * 254.0), 0, 254)
    return np.flipud(entries)


def _palette_png(entries: NDArray[np.uint8], colours: Colormap) -> str:
    image = Image.fromarray(np.ascontiguousarray(entries), mode="P")
    palette = colours(np.linspace(0.0, 1.0, 255))[:, :3]
    image.putpalette([*np.rint(255.0 * palette).astype(int).ravel().tolist(), 0, 0, 0])
    stream = io.BytesIO()
    image.save(stream, format="PNG", transparency=_BLANK, optimize=False)
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()


def _deflated(array: FloatArray) -> dict[str, Any]:
    """An array as 16-bit steps between its extremes, first row lowest; 65535 stands for NaN."""
    known = np.isfinite(array)
    low, high = (float(array[known].min()), float(array[known].max())) if known.any() else (0.0, 1.0)
    step = (high - low) / (_NO_VALUE - 1) or 1.0
    steps = np.full(array.shape, _NO_VALUE, dtype="<u2")
    steps[known] = np.rint((array[known] - low) / step)
    return {"low": low, "step": step, "deflated": base64.b64encode(zlib.compress(steps.tobytes(), 6)).decode()}
