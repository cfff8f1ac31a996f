"""PSF stacks, frames and textures of the scene benchmark: computed once, kept with the hash of what they come from.

Frames are photographed with a stack that shares no node with the decoder's calibration, neither over depth nor over the
field, and whose window is wider. ``METAFAB_SCENES`` names the folder in which all is kept.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.util import find_spec
from itertools import groupby
from pathlib import Path

import numpy as np

from metafab import camera, optics
from metafab.camera import RawFrame
from metafab.core.parallel.progress import Progress, silent
from metafab.core.parallel.work import Work
from metafab.core.storage.files import fingerprint
from metafab.core.storage.provenance import contents_sha256, sources_sha256
from metafab.optics import Psf
from metafab.spec import Design, Scene, SceneObject, load_design
from metafab.steps import optics as light
from metafab.steps.job import Job

LAYOUTS = Path(__file__).parents[2] / "layouts"
KEPT = Path(os.environ.get("METAFAB_SCENES", "runs/benchmark/scenes/kept"))
#: Depths that a decoder of the paper's lens is calibrated for, m.
CALIBRATED_M = (0.245, 0.62)
FIELD_PX = (480, 960)
#: Vergences (1/m), directions and window of the photographing stack.
_TRUE_VERGENCES = np.linspace(1.0 / 0.236, 1.0 / 0.69, 41)
_TRUE_TANGENTS = np.linspace(-0.0826, 0.0826, 16), np.linspace(-0.0413, 0.0413, 6)
_TRUE_NUMERICS = optics.PsfNumerics(window_px=96, target_error=1e-3)


@dataclass(frozen=True)
class KeptFrame:
    """A frame in its file."""

    file: Path  #: The frame.
    mark: str  #: Hash of frame and calibration.

    def load(self) -> RawFrame:
        """Read the frame."""
        return camera.load(self.file)


@dataclass(frozen=True)
class Stacks:
    """The stack that photographs and the calibration that decodes, of one lens by its target phases."""

    lens: str = "paper"  #: "paper" (2 mm, f = 20 mm) or "small" (the first page's, photographed with its calibration).
    progress: Progress = silent  #: Called over the windows.

    @cached_property
    def design(self) -> Design:
        """The design, with a scene that spans the calibrated depths."""
        if self.lens == "small":
            return load_design(LAYOUTS / "helix_small.toml")
        ends = tuple(SceneObject(depth_m=depth_m, size=(0.03, 0.03)) for depth_m in CALIBRATED_M)
        return replace(load_design(LAYOUTS / "helix_2mm.toml"), scene=Scene(objects=ends, field_px=FIELD_PX))

    @cached_property
    def calibration(self) -> Psf:
        """The decoder's pair, as ``metafab psf --ideal --calibration`` computes it."""
        return self._kept("calibration", lambda: light.calibration(self._job, None))

    @cached_property
    def true(self) -> Psf:
        """The pair that photographs."""
        if self.lens == "small":
            return self.calibration
        imaging = optics.Imaging.of(self.design)

        def compute() -> Psf:
            source = light.lit_source(self._job, light.ideal_source(self._job))
            depths_m = 1.0 / _TRUE_VERGENCES
            return optics.psf(
                source, imaging, depths_m, _TRUE_NUMERICS, field_tangents=_TRUE_TANGENTS, work=self._job.work
            )

        return self._kept("true", compute)

    @cached_property
    def pixel_tangent(self) -> float:
        """A pixel's size as a tangent."""
        imaging = optics.Imaging.of(self.design)
        return imaging.pixel_um / imaging.sensor_distance_um

    def frames(self, scenes: Mapping[int, Scene], haze_e: float = 0.0) -> Iterator[KeptFrame]:
        """One frame for each seed of textures and noise, in their order, each kept in a file.

        Args:
            scenes: photographed scene of each seed. Blurs of successive seeds with one scene are computed once.
            haze_e: mean stray electrons on every pixel of the frame, with their shot noise.
        """
        for _, group in groupby(scenes.items(), key=lambda one: one[1]):
            of_seed = dict(group)
            files = {seed: self._frame_file(scene, seed, haze_e) for seed, scene in of_seed.items()}
            missing = {seed: scene for seed, scene in of_seed.items() if not files[seed].is_file()}
            scene = next(iter(of_seed.values()))
            shot = camera.draws(scene, self.true, missing) if missing else iter(())
            for seed, file in files.items():
                if seed in missing:
                    frame = next(shot)
                    haze = np.random.default_rng((seed, 0x4A2E)).poisson(haze_e, frame.frame.shape)
                    file.parent.mkdir(parents=True, exist_ok=True)
                    camera.save(replace(frame, frame=frame.frame + haze), file, inputs_sha256=file.stem)
                yield KeptFrame(file, fingerprint(file.stem, self._mark("calibration")))

    def _frame_file(self, scene: Scene, seed: int, haze_e: float) -> Path:
        light_mark = self._mark("calibration" if self.lens == "small" else "true")
        parts = (scene, contents_sha256(scene), seed, haze_e, light_mark, sources_sha256((), ("camera",)))
        return KEPT / "frames" / f"{fingerprint(*parts)[:20]}.h5"

    @cached_property
    def _job(self) -> Job:
        return Job(self.design, KEPT, Work(progress=self.progress))

    def _mark(self, name: str) -> str:
        numerics = (_TRUE_VERGENCES, _TRUE_TANGENTS, _TRUE_NUMERICS) if name == "true" else ()
        return fingerprint(self.design, numerics, sources_sha256((), ("phase", "optics")))[:20]

    def _kept(self, name: str, compute: Callable[[], Psf]) -> Psf:
        mark = self._mark(name)
        file = KEPT / f"{self.lens}_{name}_{mark}.h5"
        if not file.is_file():
            KEPT.mkdir(parents=True, exist_ok=True)
            optics.save(compute(), file, inputs_sha256=mark)
        return optics.load(file)


def picture(name: str, width_px: float, height_px: float) -> dict[str, object]:
    """Texture of an object of a size in pixels: a picture of scikit-image, or a fractal without scikit-image.

    The picture is scaled to two texels a pixel, so that its finest detail is the camera's.

    Returns:
        Fields of a :class:`metafab.spec.SceneObject`.
    """
    from PIL import Image

    package = find_spec("skimage")
    if package is None or package.origin is None:
        return {"texture": "fractal", "texture_contrast": 0.4}
    size = (2 * round(width_px), 2 * round(height_px))
    file = KEPT / "textures" / f"{name}_{size[0]}x{size[1]}.png"
    if not file.is_file():
        file.parent.mkdir(parents=True, exist_ok=True)
        (original,) = (Path(package.origin).parent / "data").glob(f"{name}.[jp][pn]g")
        grey = Image.open(original).convert("L")
        grey.resize(size, Image.Resampling.LANCZOS).save(file)
    values = np.asarray(Image.open(file), dtype=np.float64)
    return {
        "texture": "image",
        "texture_file": file,
        "texture_contrast": min(float(values.std() / values.mean()), 1.0),
    }
