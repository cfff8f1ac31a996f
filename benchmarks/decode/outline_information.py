"""What a frame tells about the place of an outline: the likelihood of the true one beside displaced ones.

``python -m benchmarks.decode.outline_information`` takes places on the outlines of the scene benchmark's frames. About
each, a stretch of the true outline is displaced by 1 to 3 px, outward (the nearer object grows) or inward. The frame is
taken as the sum of the light of both layers, each blurred by the calibrated pair at its true depth, with the occlusion
of the camera. The light is free: its texture has a 1/k spectrum and an rms of 0.3, as in the decoder. So the images are
normally distributed, and the light is integrated out exactly, with the covariance of all pixels of a window.

A table has twice the logarithm of the likelihood of the true outline over that of the displaced one, the median over
the places, in the frame with its noise. Below 4 no decoder can tell the two apart by the light; far above 10 one that
errs there loses what the frame holds. ``off`` is the mean distance of the decoder's outline from the true one.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.linalg.blas import ssyrk
from scipy.ndimage import convolve1d, distance_transform_edt, gaussian_filter, uniform_filter

from benchmarks.decode.scene_cases import CASES, Case
from benchmarks.decode.scene_judge import Decoded
from benchmarks.decode.scene_stacks import Stacks
from metafab.core.conventions import FloatArray
from metafab.decode import Decoder
from metafab.decode.segmentation.layered.layer_light import LayerOptics, at_depth, texture_amplitude
from metafab.decode.segmentation.prepared_frame import PreparedFrame

#: Scenes by default, lengths of the stretches and displacements, pixels.
SCENES = ("ball", "edge", "highlights", "natural_1")
LENGTHS_PX, DISPLACED_PX = (8, 16, 32), (-3, -2, -1, 1, 2, 3)
#: Side of the compared square and of the light about it, downsampled pixels.
_INNER, _SIDE = 28, 56
#: Rms contrast of the textures, and error of the calibration as a share of the light.
_TEXTURE, _MODEL_ERROR = 0.3, 0.005
#: Difference of the logarithms of I_x / I_y from which contrasts are unlike, and least ratio of the depths.
_UNLIKE, _LEAST_RATIO = 0.1, 1.05
#: Filters by which a mask is brought to every second or third pixel.
_BLOCKS = {1: (1.0,), 2: (0.25, 0.5, 0.25), 3: (1 / 3, 1 / 3, 1 / 3)}


@dataclass(frozen=True)
class Place:
    """A place on an outline between two objects."""

    row: int  #: Row of the outline's pixel.
    column: int  #: Column of the outline's pixel.
    near: NDArray[np.bool_]  #: Shape (n_y, n_x), pixels of the nearer object by depth.
    depths_m: tuple[float, float]  #: Depth of the nearer and of the farther object.
    light: FloatArray  #: Shape (2, 2), mean electrons of both objects (nearer, farther) in both images.

    @property
    def unlike(self) -> bool:
        """Whether the polarisation contrasts of the objects differ."""
        ratio = np.log(self.light[:, 0] / self.light[:, 1])
        return bool(abs(ratio[0] - ratio[1]) > _UNLIKE)

    def _stretch(self, length_px: float) -> NDArray[np.bool_]:
        """Pixels beside a stretch of the outline, by the tangent at the place: shape (n_y, n_x)."""
        slope = np.array([one[self.row, self.column] for one in np.gradient(gaussian_filter(self.near * 1.0, 3.0))])
        normal = slope / max(float(np.hypot(*slope)), 1e-9)
        row, column = (np.arange(n)[place] - at for n, place, at in self._axes())
        along, across = row * normal[1] - column * normal[0], row * normal[0] + column * normal[1]
        return np.asarray((np.abs(along) <= 0.5 * length_px) & (np.abs(across) <= 8.0))

    def _axes(self) -> Iterator[tuple[int, tuple[slice, None] | tuple[None, slice], int]]:
        yield self.near.shape[0], (slice(None), None), self.row
        yield self.near.shape[1], (None, slice(None)), self.column

    def displaced(self, length_px: float, by_px: int) -> NDArray[np.bool_]:
        """The nearer object's pixels with a stretch of its outline displaced, outward if positive: shape (n_y, n_x)."""
        beyond = np.where(self.near, 0.5 - distance_transform_edt(self.near), distance_transform_edt(~self.near) - 0.5)
        return np.where(self._stretch(length_px), beyond < by_px, self.near)

    def off_px(self, decoded_m: FloatArray) -> float:
        """Mean distance of a decoded outline from the true one along the longest stretch, pixels."""
        near_m, far_m = self.depths_m
        wrong = (np.abs(np.log(decoded_m / near_m)) < np.abs(np.log(decoded_m / far_m))) != self.near
        return float((wrong & self._stretch(LENGTHS_PX[-1]) & np.isfinite(decoded_m)).sum() / LENGTHS_PX[-1])


class Window:
    """The normal distribution of both images in a square about a place, for any outline."""

    def __init__(self, prepared: PreparedFrame, optics: LayerOptics, place: Place) -> None:
        """Cut the square out of a frame, and compute the images of both layers' light."""
        self.step = prepared.downsampling.step
        self.middle = place.row // self.step, place.column // self.step
        self.side = max(_SIDE, optics.kernels.shape[-1])
        first = (self.side - _INNER) // 2
        self.inner = slice(first, first + _INNER)
        square, _ = prepared.about(self.middle, self.side)
        self.images = square[:, self.inner, self.inner].astype(np.float64)
        mean = np.maximum(uniform_filter(square, (0, 7, 7)), 0.0)[:, self.inner, self.inner]
        read_e2 = prepared.levels.read_noise_e**2
        self.variance = ((mean + read_e2) / self.step**2 + (_MODEL_ERROR * mean) ** 2).ravel()
        vergences = [1.0 / one for one in place.depths_m]
        pair = optics.pair_about(self.middle, self.side)
        blur = np.stack([at_depth(optics, pair, one) for one in vergences])
        self.blur = blur / blur[:, :, :1, :1].real
        self.light = place.light[:, :, None, None]
        self.aperture = optics.aperture(vergences[0] - vergences[1], (self.side, self.side))
        self.texture = _TEXTURE * texture_amplitude((self.side, self.side), self.step)
        points = np.zeros((_INNER, _INNER, self.side, self.side), dtype=np.float32)
        for at in np.ndindex(_INNER, _INNER):
            points[*at, first + at[0], first + at[1]] = 1.0
        spectra = scipy.fft.rfft2(points)
        # Light of each layer at all places that each pixel of each image receives.
        self.received = [
            [
                self._pictures(spectra * one.conj()) * place.light[layer, image]
                for image, one in enumerate(blur_of_layer)
            ]
            for layer, blur_of_layer in enumerate(self.blur)
        ]

    def minus_twice_log_likelihood(self, near: NDArray[np.bool_]) -> float:
        """That of the frame for an outline of the nearer object, shape (n_y, n_x) of the frame, plus a constant."""
        cover = near.astype(np.float64)
        for axis in (0, 1):
            cover = convolve1d(cover, _BLOCKS[self.step], axis=axis, mode="nearest")
        corner = [at - self.side // 2 for at in self.middle]
        rows, columns = (np.arange(c, c + self.side) for c in corner)
        small = cover[:: self.step, :: self.step]
        cut = small[np.ix_(np.clip(rows, 0, small.shape[0] - 1), np.clip(columns, 0, small.shape[1] - 1))]
        spectrum = scipy.fft.rfft2(cut.astype(np.float32))
        veil = self._pictures(self.blur[0] * spectrum)
        mean = (self.light[0] * veil + self.light[1] * (1.0 - veil))[:, self.inner, self.inner]
        seen = cut.astype(np.float32), np.clip(1.0 - self._pictures(spectrum * self.aperture), 0.0, 1.0)
        root = cholesky(self._covariance(seen), lower=True, overwrite_a=True, check_finite=False)
        white = solve_triangular(root, (self.images - mean).ravel(), lower=True, check_finite=False)
        return float(white @ white + 2.0 * np.log(np.diag(root)).sum())

    def _covariance(self, seen: tuple[NDArray[np.float32], NDArray[np.float32]]) -> FloatArray:
        """Covariance of all pixels of both images for the visible shares of both layers; its lower triangle."""
        total = np.zeros((self.variance.size,) * 2, dtype=np.float32, order="F")
        for received, share in zip(self.received, seen, strict=True):
            textured = [
                self._pictures(scipy.fft.rfft2(one * share.astype(np.float32)) * self.texture).reshape(_INNER**2, -1)
                for one in received
            ]
            total = ssyrk(1.0, np.concatenate(textured).T, beta=1.0, c=total, trans=1, lower=1, overwrite_c=1)
        return np.asarray(total + np.diag(self.variance))

    def _pictures(self, spectra: NDArray[np.complex64]) -> NDArray[np.float32]:
        return np.asarray(scipy.fft.irfft2(spectra, (self.side, self.side)), dtype=np.float32)


def places(seen: Decoded, prepared: PreparedFrame, count: int, seed: int) -> Iterator[Place]:
    """Places on outlines with two objects about them, in random order, a window apart."""
    truth, step = seen.truth, prepared.downsampling.step
    half, found = _SIDE * step // 4 + 6, 0
    on_outline = np.argwhere((seen.edge_px < 1.0) & np.isfinite(truth.depth_m))
    taken: list[tuple[int, int]] = []
    for row, column in np.random.default_rng(seed).permutation(on_outline).tolist():
        box = slice(max(0, row - half), row + half), slice(max(0, column - half), column + half)
        depth, label = truth.depth_m[box], truth.label[box]
        numbers = np.unique(label).tolist()
        if depth.shape != (2 * half, 2 * half) or len(numbers) != 2 or not np.isfinite(depth).all():
            continue
        if any(max(abs(row - y), abs(column - x)) < half for y, x in taken):
            continue
        near, far = sorted(numbers, key=lambda number: float(np.median(depth[label == number])))
        near_m, far_m = (float(np.median(depth[label == number])) for number in (near, far))
        spoiled = prepared.spoiled[tuple(slice(one.start // step, one.stop // step) for one in box)]
        if far_m < _LEAST_RATIO * near_m or spoiled.any():
            continue
        taken.append((row, column))
        is_near = np.abs(np.log(truth.depth_m / near_m)) < np.abs(np.log(truth.depth_m / far_m))
        light = seen.true_intensity[:, *box]
        means = np.array([light[:, label == number].mean(axis=1) for number in (near, far)])
        yield Place(row, column, is_near, (near_m, far_m), means)
        found += 1
        if found == count:
            return


def measured(
    case: Case, count: int, seeds: int, lengths_px: Sequence[int] = LENGTHS_PX
) -> Iterator[tuple[bool, float, FloatArray]]:
    """Whether contrasts are unlike, the decoder's distance, and a table (n_lengths, n_displaced), for each place."""
    stacks = Stacks(case.lens)
    scenes = {seed: case.scene(stacks.pixel_tangent, seed) for seed in range(1, seeds + 1)}
    for seed, kept in zip(scenes, stacks.frames(scenes, case.haze_e), strict=True):
        frame = kept.load()
        decoder = Decoder.of(stacks.calibration, frame.frame.shape, frame.origin_um, frame.x_window)
        prepared = None if decoder is None else decoder.prepare(frame)
        if decoder is None or prepared is None or isinstance(prepared, str):
            raise ValueError(f"no frame of {case.name} can be decoded")
        seen = Decoded.of(decoder(frame), frame)
        for place in places(seen, prepared, count, seed):
            window = Window(prepared, decoder.layer_optics, place)
            true = window.minus_twice_log_likelihood(place.near)
            table = [
                [window.minus_twice_log_likelihood(place.displaced(length, by)) - true for by in DISPLACED_PX]
                for length in lengths_px
            ]
            yield place.unlike, place.off_px(seen.depth_m), np.array(table)


def main() -> None:
    """Print one table a scene and kind of outline."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=SCENES, help="names of the scene benchmark's scenes")
    parser.add_argument("--places", type=int, default=4, help="places in a frame")
    parser.add_argument("--seeds", type=int, default=3, help="frames of a scene")
    parser.add_argument("--lengths", type=int, nargs="+", default=LENGTHS_PX, help="lengths of the stretches, pixels")
    options = parser.parse_args()
    cases = {case.name: case for case in CASES}
    print(
        "| scene | contrasts | places | off, px | stretch, px | "
        + " | ".join(f"{by:+d} px" for by in DISPLACED_PX)
        + " |"
    )
    print("|---" * (5 + len(DISPLACED_PX)) + "|")
    for name in options.scenes:
        found = list(measured(cases[name], options.places, options.seeds, options.lengths))
        for unlike, word in ((False, "like"), (True, "unlike")):
            some = [one for one in found if one[0] == unlike]
            if not some:
                continue
            off = np.mean([one[1] for one in some])
            medians = np.median([one[2] for one in some], axis=0)
            for length, row in zip(options.lengths, medians, strict=True):
                values = " | ".join(f"{value:.0f}" for value in row)
                print(f"| {name} | {word} | {len(some)} | {off:.2f} | {length} | {values} |", flush=True)


if __name__ == "__main__":
    main()
