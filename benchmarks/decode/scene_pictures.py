"""Pictures with their depth for the scene benchmark: one of scikit-image, and others with depths of our own.

The Middlebury motorcycle has measured depths. The others are hard for a decoder: steps of depth that the light hardly
shows, a plain dim ground about textured objects, where the twins agree in the blur of outlines alone, and a room whose
walls are steep and partly plain.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter

from benchmarks.decode.scene_stacks import KEPT
from metafab.core.conventions import FloatArray
from metafab.core.storage.files import file_sha256, whole_file
from metafab.spec import Scene
from metafab.spec.scene import Rgbd

FIELD_PX = (480, 800)
#: Depths that a picture's are scaled into, m.
RANGE_M = (0.25, 0.60)
#: Steps of depth of a photograph, and standard deviation of the Gaussian before its light is cut into them, pixels.
_STEPS, _STEPS_PX = 8, 6.0
#: Standard deviations of the Gaussians of random objects and slopes, pixels.
_OBJECT_PX, _SLOPE_PX = 25.0, 70.0
#: Half width of a room's back wall, as a share of the field's. Boxes in the room: photograph, depth in m, middle and
#: half sides as shares of the field's half sides.
_BACK_WALL = 0.45
_BOXES = (
    ("coins", 0.38, (-0.45, 0.35), (0.14, 0.27)),
    ("camera", 0.33, (0.1, 0.5), (0.19, 0.21)),
    ("chelsea", 0.44, (0.5, -0.2), (0.12, 0.31)),
)
#: Light of the plain ground over the objects' mean.
_GROUND = 0.35


def rgbd(name: str, electrons: float) -> Callable[[float, int], Scene]:
    """Scene of a picture by its name, as those of :class:`benchmarks.decode.scene_cases.Case`; seeds vary the noise."""

    def scene(pixel: float, seed: int) -> Scene:
        source = "fractals" if _data() is None else "scikit-image"
        folder = KEPT / "pictures" / f"{file_sha256(Path(__file__))[:12]}_{source}"
        files = folder / f"{name}_light.npy", folder / f"{name}_depth.npy"
        if not all(file.is_file() for file in files):
            for file, values in zip(files, _PICTURES[name](), strict=True):
                with whole_file(file) as part, part.open("wb") as stream:
                    np.save(stream, values)
        picture = Rgbd(image_file=files[0], depth_file=files[1], depth_range_m=RANGE_M)
        return Scene(rgbd=picture, field_px=FIELD_PX, photons_per_pixel=electrons)

    return scene


def _data() -> Path | None:
    """Folder of scikit-image's pictures; None without it."""
    package = find_spec("skimage")
    return None if package is None or package.origin is None else Path(package.origin).parent / "data"


def _photograph(name: str) -> FloatArray:
    """A picture of scikit-image that fills the field, or a 1/k fractal: shape ``FIELD_PX``, positive."""
    data, (n_y, n_x) = _data(), FIELD_PX
    if data is None:
        k = np.hypot(*np.meshgrid(np.fft.fftfreq(n_y), np.fft.fftfreq(n_x), indexing="ij"))
        waves = np.fft.fft2(np.random.default_rng(0).normal(size=FIELD_PX)) / np.maximum(k, 1.0 / n_x)
        fractal = np.fft.ifft2(waves).real
        return np.asarray(np.exp(0.4 * fractal / fractal.std()))
    (file,) = data.glob(f"{name}.[jp][pn]g")
    grey = Image.open(file).convert("L")
    scale = max(n_y / grey.height, n_x / grey.width)
    size = max(n_x, round(grey.width * scale)), max(n_y, round(grey.height * scale))
    values = np.asarray(grey.resize(size, Image.Resampling.LANCZOS), dtype=np.float64)
    top, left = (values.shape[0] - n_y) // 2, (values.shape[1] - n_x) // 2
    return values[top : top + n_y, left : left + n_x] + 2.0


def _motorcycle() -> tuple[FloatArray, FloatArray]:
    """Left view of the Middlebury motorcycle and the inverse of its disparity; without scikit-image, plain ground."""
    data = _data()
    if data is None:
        return _plain_ground()
    light = np.asarray(Image.open(data / "motorcycle_left.png").convert("RGB"), dtype=np.float64).mean(axis=-1)
    disparity = np.load(data / "motorcycle_disp.npz")["arr_0"].astype(np.float64)
    known = np.isfinite(disparity) & (disparity > 0.0)
    return light, np.where(known, 1.0 / np.where(known, disparity, 1.0), np.nan)


def _steps() -> tuple[FloatArray, FloatArray]:
    """A photograph that is the farther, the darker its surroundings are, in steps of equal numbers of pixels."""
    light = _photograph("coffee")
    slow = gaussian_filter(light, _STEPS_PX)
    step = np.digitize(slow, np.quantile(slow, np.arange(1, _STEPS) / _STEPS))
    return light, 1.0 / _vergence(step / (_STEPS - 1.0))


def _plain_ground() -> tuple[FloatArray, FloatArray]:
    """Slopes with a photograph on them, of a third of the field, before slopes without texture."""
    rng = np.random.default_rng(1)
    objects, near, far = (
        gaussian_filter(rng.normal(size=FIELD_PX), px, mode="wrap") for px in (_OBJECT_PX, _SLOPE_PX, _SLOPE_PX)
    )
    is_object, photograph = objects > np.quantile(objects, 2.0 / 3.0), _photograph("coffee")
    light = np.where(is_object, photograph / photograph[is_object].mean(), _GROUND)
    share = np.where(is_object, 0.5 + 0.4 * _of_range(near), 0.4 * _of_range(far))
    return light, 1.0 / _vergence(share)


def _room() -> tuple[FloatArray, FloatArray]:
    """A view along a room: back wall, side walls, floor and ceiling with photographs on them, and three boxes."""
    (n_y, n_x), (near_m, far_m) = FIELD_PX, RANGE_M
    y, x = np.meshgrid(np.linspace(-1.0, 1.0, n_y), np.linspace(-1.0, 1.0, n_x), indexing="ij")
    brick, gravel, grass = (one / one.mean() for one in map(_photograph, ("brick", "gravel", "grass")))
    # Walls recede in perspective: their depth is that of the back wall over the distance from the middle.
    nearness = np.maximum(np.maximum(np.abs(x), np.abs(y)) / _BACK_WALL, 1.0)
    depth_m = near_m + (far_m - near_m) * (1.0 / nearness - _BACK_WALL) / (1.0 - _BACK_WALL)
    sides, ends = np.where(x > 0.0, 0.9 * brick, 0.7 * grass), np.where(y > 0.0, 0.8 * grass, 1.1 * gravel)
    light = np.where(nearness == 1.0, brick, np.where(np.abs(x) > np.abs(y), sides, ends))
    for name, box_m, (left, top), (width, height) in _BOXES:
        box = (depth_m > box_m) & (np.abs(x - left) < width) & (np.abs(y - top) < height)
        photograph = _photograph(name)
        light, depth_m = np.where(box, photograph / photograph.mean(), light), np.where(box, box_m, depth_m)
    return light, depth_m


def _of_range(values: FloatArray) -> FloatArray:
    """Values as shares of their range, 0 to 1."""
    return np.asarray((values - values.min()) / np.ptp(values))


def _vergence(share: FloatArray) -> FloatArray:
    """1/depth between the ends of the range, 1/m, the far one for 0."""
    near, far = RANGE_M
    return np.asarray(1.0 / far + share * (1.0 / near - 1.0 / far))


_PICTURES = {"motorcycle": _motorcycle, "steps": _steps, "plain_ground": _plain_ground, "room": _room}
