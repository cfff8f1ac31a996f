"""Loss chain of a written mask: the factors of its efficiency, from the aperture to the image.

The field behind the pillars is the target wave, u = exp(i target phase), times c = <a u*>, plus a rest that is
orthogonal to it. |c|^2 is the share of the light in the target wave. It is the product of the transmittance, the
overlap that the library allows with continuous sizes, the loss by snapping to the size grid, and the loss at the rim,
where no whole cell fits. Full-wave rows of the mask give a further loss by coupling between unlike neighbours. The
target wave loses the light that misses the opening (a pinhole, or the frame of a hologram's picture); some of the rest
enters it. The factors multiply to the efficiency of the written mask, which is measured independently. The chain of a
deflector ends with the target wave.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.spatial import cKDTree

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.figures import Loss, Wavefront
from metafab.core.numeric.phasor import phasor
from metafab.library.library import Library
from metafab.optics.sources.neighbours import NeighbourField
from metafab.optics.sources.source import WrittenField
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Device

#: Largest number of sites, in evenly spaced rows, and of target phases that are mapped to continuous sizes.
_MOST_SITES, _TARGETS = 3_000_000, 20_000
#: Step of the sizes that represent continuous ones, nm.
_FINE_NM = 0.5


def wavefront(
    written: WrittenField | NeighbourField, profile: PhaseProfile, device: Device, library: Library
) -> Wavefront:
    """Compare the field of the written pillars with the target phases, on sampled rows of the lens."""
    sums = np.zeros((2, 2), dtype=np.complex128)  # [half of the rows, polarisation]
    powers, counts, inside = np.zeros((2, 2)), np.zeros(2), 0
    targets: list[FloatArray] = []
    for row, site_amplitude, site_target_rad in _rows(written, profile, device):
        half, inside = row % 2, inside + site_target_rad.shape[1]
        lit = site_amplitude.any(axis=0)
        amplitude, target_rad = site_amplitude[:, lit], site_target_rad[:, lit]
        sums[half] += np.sum(amplitude * phasor(-target_rad), axis=1)
        powers[half] += np.sum(np.abs(amplitude) ** 2, axis=1)
        counts[half] += target_rad.shape[1]
        targets.append(target_rad[:, :: max(1, target_rad.shape[1] // 64)])
    with np.errstate(invalid="ignore"):
        halves = np.abs(sums) ** 2 / (powers * counts[:, None])
        whole = np.abs(sums.sum(axis=0)) ** 2 / (powers.sum(axis=0) * counts.sum())
    scatter = 0.5 * np.abs(halves[0] - halves[1]) if counts.all() else np.full(2, np.nan)
    some = np.concatenate(targets, axis=1)
    some = some[:, :: max(1, some.shape[1] // _TARGETS)] + np.angle(sums.sum(axis=0))[:, None]
    best = _best_overlap(written, some, library)
    return Wavefront(
        overlap=(float(whole[0]), float(whole[1])),
        error=(float(scatter[0]), float(scatter[1])),
        best_overlap=(float(best[0]), float(best[1])),
        filled=float(counts.sum() / max(inside, 1)),
        sites=int(counts.sum()),
    )


def loss_chain(
    front: Wavefront,
    transmitted: FloatArray,
    passed: FloatArray | None = None,
    ideal_passed: FloatArray | None = None,
    coupling: Sequence[float] | None = None,
    stopped: FloatArray | None = None,
    opening: str = "pinhole",
) -> list[Loss]:
    """Return the factors from the aperture to an opening about the image, or to the target wave.

    Args:
        front: overlap of the transmitted light with the target wave.
        transmitted: shape (2,), share of the light at the aperture that the pillars transmit.
        passed: shape (2,), share that passes the opening behind the written mask, by the library; None for no opening.
        ideal_passed: shape (2,), share that passes the opening behind the target phases.
        coupling: efficiency of full-wave rows over that of the same rows by the library, of x and of y polarised light;
            None if not measured.
        stopped: shape (2,), share that substrate, stop and amplitude before the pillars pass with its polarisation
            kept, a factor of the other three shares; None without these elements.
        opening: name of the opening.

    Returns:
        Losses whose factors multiply to ``passed``, or to the share in the target wave, times ``coupling``.
    """
    overlap, best = np.array(front.overlap), np.array(front.best_overlap)
    before = [] if stopped is None else [_loss("substrate, stop and amplitude before the pillars", stopped)]
    if stopped is not None:
        transmitted = transmitted / stopped
    # Dark sites reduce the power by their share, and the peak of the image by its square.
    wanted = transmitted * overlap * front.filled
    losses = [
        *before,
        _loss("through the pillars", transmitted),
        _loss("wave that the library can follow", best),
        _loss("sizes snapped to the grid", overlap / best),
        Loss("rim without whole cells", (front.filled, front.filled)),
        Loss("unlike neighbours, full-wave", None if coupling is None else (coupling[0], coupling[1])),
    ]
    if passed is not None and ideal_passed is not None:
        ideally, share = (each if stopped is None else each / stopped for each in (ideal_passed, passed))
        losses.append(_loss(f"target phases through the {opening}", ideally))
        losses.append(_loss(f"stray light into the {opening}", share / (wanted * ideally)))
    return losses


def _loss(stage: str, factor: FloatArray) -> Loss:
    return Loss(stage, (float(factor[0]), float(factor[1])))


def _rows(
    written: WrittenField | NeighbourField, profile: PhaseProfile, device: Device
) -> Iterator[tuple[int, ComplexArray, FloatArray]]:
    """Row number, amplitudes (2, n) and target phases (2, n) of the sites inside the aperture, for sampled rows."""
    lattice = written.lattice
    x_um, y_um = lattice.x_um(), lattice.y_um()
    every = max(1, -(-x_um.size * y_um.size // _MOST_SITES))
    for tile in written.tiles():
        n_y, n_x = tile.amplitude(0).shape
        chosen = np.arange(-tile.row % every, n_y, every)
        if not chosen.size:
            continue
        columns, rows = x_um[tile.column : tile.column + n_x], y_um[tile.row + chosen]
        inside = device.encloses(columns, rows)
        if lattice.hexagonal:
            inside &= lattice.carries(tile.row + chosen, tile.column + np.arange(n_x))
        target_rad = profile(columns, rows)
        amplitude = np.array([tile.amplitude(p)[chosen] for p in (0, 1)])
        for i, row in enumerate(chosen):
            if inside[i].any():
                yield int(tile.row + row) // every, amplitude[:, i, inside[i]], target_rad[:, i, inside[i]]


def _best_overlap(written: WrittenField | NeighbourField, target_rad: FloatArray, library: Library) -> FloatArray:
    """|<a u*>|^2 / <|a|^2> of continuous sizes in the range of the mask.

    The largest inner product with the target wave becomes a nearest-neighbour search once a fifth coordinate makes the
    vectors of all sizes equally long (:mod:`metafab.library.use.lookup`).
    """
    size_nm = written.pillars.size_nm()[1:]
    axes = [_fine_axis(size_nm[:, axis], min(library.width_nm.size, library.length_nm.size)) for axis in (0, 1)]
    width, length = np.meshgrid(*axes)
    continuous = min(a.size for a in axes) > 1 and library.is_continuous
    fine = library.surface(width, length) if continuous else library.at_sizes(*size_nm.T)
    t = np.stack([fine.t_xx.ravel(), fine.t_yy.ravel()], axis=1)
    parts = np.stack([t[:, 0].real, t[:, 0].imag, t[:, 1].real, t[:, 1].imag], axis=1)
    square = (parts**2).sum(axis=1)
    sized = np.concatenate([parts, np.sqrt(square.max() - square)[:, None]], axis=1)
    # The sizes lie on a surface, for which a tree of boxes halved in the middle answers in half the time.
    tree = cKDTree(sized, balanced_tree=False, compact_nodes=False)
    (x, y), none = target_rad, np.zeros(target_rad.shape[1])
    wanted = np.stack([np.cos(x), np.sin(x), np.cos(y), np.sin(y), none], axis=1)
    chosen = t[tree.query(wanted)[1]].T
    coherent = np.abs((chosen * phasor(-target_rad)).mean(axis=1)) ** 2
    return np.asarray(coherent / (np.abs(chosen) ** 2).mean(axis=1))


def _fine_axis(sizes_nm: FloatArray, library_sizes: int) -> FloatArray:
    """Fine sizes from the smallest to the largest of the mask; one size for a library too small for a surface."""
    low, high = float(sizes_nm.min()), float(sizes_nm.max())
    if library_sizes < 4 or high <= low:
        return np.array([low])
    return np.linspace(low, high, round((high - low) / _FINE_NM) + 1)
