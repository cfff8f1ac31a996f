"""Table and picture of the page that sets the paper beside metafab, from finished runs.

``python docs/paper_page.py`` reads ``runs/helix_2mm`` (and ``helix_outdoor``, ``helix_5cm``, ``people`` with the frame
and the decoding of ``layouts/scenes/people.toml``, and ``comparison.json`` in the first, where they are) and writes
``docs/paper_table.inc`` and ``docs/paper.png``.
"""

from __future__ import annotations

import argparse
import json
import re
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt
from overview_picture import DEPTHS, pairs

from metafab import camera, decode, optics
from metafab.comparison import Comparison, load_comparison
from metafab.phase import profile_of
from metafab.spec import load_design

ROOT = Path(__file__).parents[1]
#: Other scenes: folder of the run, and title.
OTHERS = {"helix_outdoor": "cars outdoors", "people": "people outdoors", "helix_5cm": "5 cm at 200 m"}
#: Decodings of which the fastest is stated.
REPEATS = 5


def main() -> None:
    """Write table and picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="?", type=Path, default=ROOT / "runs", help="folder of the run folders")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs", help="folder of table and picture")
    parser.add_argument("--library", type=Path, default=ROOT / "unitcell_lib" / "sos_800nm.h5")
    arguments = parser.parse_args()
    found = {path.parent.name: _json(path) for path in sorted(arguments.runs.glob("helix_*/summary.json"))}
    comparison = arguments.runs / "helix_2mm" / "comparison.json"
    lines = ["| what | paper | metafab | agreement |", "|---|---|---|---|"]
    seconds = decoding_s(arguments.runs / "helix_2mm")
    table = rows(found, seconds, _json(comparison) if comparison.is_file() else None)
    lines += [re.sub(r"(\d)%", r"\1 %", "| " + " | ".join(row) + " |") for row in table]
    (arguments.output / "paper_table.inc").write_text("\n".join(lines) + "\n", encoding="utf-8")
    picture(arguments.runs, arguments.library, found["helix_2mm"], arguments.output / "paper.png")


def decoding_s(run: Path) -> float:
    """Shortest processor time of decoding the run's frame by a decoder that is prepared for its calibration."""
    pair = optics.load(run / "psf.h5")
    frame = camera.load_frame(run / "raw.h5", pair)
    decoder = decode.Decoder.of(pair, frame.frame.shape, frame.origin_um, frame.x_window)
    assert decoder is not None, f"{run}: the frame does not hold both images"
    times = []
    for _ in range(REPEATS):
        start = time.process_time()
        decoder(replace(frame, truth=None))
        times.append(time.process_time() - start)
    return min(times)


def rows(
    found: dict[str, dict[str, Any]], seconds: float, comparison: dict[str, Any] | None
) -> list[tuple[str, str, str, str]]:
    """Return the rows of the table: quantity, the paper's value, ours (decoding in ``seconds``), agreement."""
    lens = found["helix_2mm"]
    phase, cells, layout, merit, decoded = (lens[k] for k in ("phase", "library", "layout", "merit", "decode"))
    middle = merit["depth_m"].index(min(merit["depth_m"], key=lambda z: abs(z - 0.31)))
    table = [
        ("phase range of the pillars (Fig. 2c)", "full 2π", f"{cells['coverage_rad'] / np.pi:.2f}π", "agrees"),
        (
            "pairs of x and y phase within reach",
            "independent control",
            f"{cells['torus_coverage']:.1%}, worst hole {cells['worst_hole_rad']:.2f} rad",
            "nearly: large pillars near (0, -1) rad transmit little",
        ),
        ("transmittance (Supp. 2)", "near unity", f"mean {layout['mean_transmittance']:.3f}", "lower"),
        ("smallest gap", "over 100 nm", f"{layout['min_gap_nm']:g} nm", "agrees"),
        ("peak gained by optimisation", "36 %", f"{phase['peak_gain'] - 1.0:.0%} (mean over depth)", "agrees"),
        (
            "diffraction efficiency x, y",
            "0.4454, 0.4393",
            ", ".join(f"{merit[f'pinhole_efficiency_{p}'][middle]:.3f}" for p in "xy") + " (written file)",
            "no: [the made lens](made-lens.md)",
        ),
        (
            "extinction ratio",
            "35.6",
            f"{merit['extinction_ratio'][middle]:.0f} (written file)",
            "no: [the made lens](made-lens.md)",
        ),
        (
            "depth of the indoor scene, NMAE (Fig. 3)",
            "0.37 %",
            f"{decoded['nmae']:.2%} (simulated, other objects)",
            "ours has no calibration error",
        ),
        (
            "reconstruction, 500 x 1000 pixels",
            "below 0.4 s (i7-10875H)",
            f"{seconds:.2f} s of processor time (480 x 960, best of {REPEATS})",
            "agrees: faster ([](../benchmarks/decoder.md))",
        ),
    ]
    if "helix_outdoor" in found:
        outdoor = found["helix_outdoor"]["decode"]
        table.append(
            (
                "cars outdoors, NMAE (Fig. 4)",
                "0.78 % (still), 1.26 % (moving)",
                f"{outdoor['object_error']:.2%} by object, {outdoor['nmae']:.2%} over all pixels",
                "same order",
            )
        )
    if "helix_5cm" in found:
        far = found["helix_5cm"]["decode"]
        table.append(
            (
                "5 cm aperture at 200 m (Supp. 6)",
                "estimated well below 1 %",
                f"{far['object_error']:.2%} by object, {far['nmae']:.2%} over all pixels",
                "agrees by object",
            )
        )
    if comparison is not None:
        error = {
            n: float(np.sqrt(np.mean(np.square(e))))
            for n, e in zip(comparison["methods"], comparison["error"], strict=True)
        }
        ratio = error["standard lens"] / error["this design"]
        table.append(
            ("depth against a standard lens (Supp. 7)", "Fisher information x 100", f"error / {ratio:.0f}", "see below")
        )
    return table


def picture(runs: Path, library: Path, summary: dict[str, Any], path: Path) -> None:
    """Maps of the library, phases, orientation, PSFs, depth against a standard lens, efficiency, and the scenes."""
    run, further = runs / "helix_2mm", [name for name in OTHERS if (runs / name / "decoded.h5").is_file()]
    plt.rcParams.update({"font.size": 8})
    figure = plt.figure(figsize=(11.0, 11.6 if further else 10.4), layout="constrained")
    ratios = (1.0, 1.15, 0.95, 0.62, 0.6)[: 5 if further else 4]
    top, middle, figures, bottom, *last = figure.subfigures(len(ratios), 1, height_ratios=ratios)
    maps(top.subplots(1, 4), library, run)
    left, right = middle.subfigures(1, 2, width_ratios=(1.0, 2.0))
    orientation(left.subplots(), summary)
    pairs(right.subplots(2, DEPTHS), run)
    against_lens, through = figures.subplots(1, 2, width_ratios=(1.0, 1.2))
    compared = load_comparison(run / "comparison.json")
    if compared is not None:
        rivals(against_lens, compared)
    efficiency(through, summary["merit"])
    scene(bottom.subplots(1, 4), run, summary["decode"]["nmae"])
    if further:
        others(last[0].subplots(1, 2 * len(further), squeeze=False)[0], runs, further)
    figure.savefig(path, dpi=90, facecolor="white")


def maps(places: np.ndarray, library: Path, run: Path) -> None:
    """Transmitted phase and power of x polarised light over the sizes, and both optimised helix phases."""
    with h5py.File(library) as file:
        t, width, length = file["t_xx"][0], file["width_nm"][:], file["length_nm"][:]
    span = (width[0], width[-1], length[0], length[-1])
    shown = (
        ("phase of t_xx / rad", np.angle(t), "twilight"),
        ("power transmittance, x", np.abs(t) ** 2 / 1.7601, "viridis"),
    )
    for place, (title, values, colours) in zip(places[:2], shown, strict=True):
        drawn = place.imshow(values, origin="lower", extent=span, cmap=colours)
        place.set(title=title, xlabel="width / nm", ylabel="length / nm")
        plt.colorbar(drawn, ax=place, shrink=0.8)
    design = load_design(ROOT / "layouts" / "helix_2mm.toml")
    helix = profile_of(replace(design, phase=design.phase[:1]))
    half_mm = 0.5e-3 * design.device.aperture_um
    axis_um = np.linspace(-1e3 * half_mm, 1e3 * half_mm, 301)
    phases = helix(axis_um, axis_um)
    outside = np.hypot(axis_um, axis_um[:, None]) > 1e3 * half_mm
    for place, phase, name in zip(places[2:], phases, "xy", strict=True):
        wrapped = np.where(outside, np.nan, np.angle(np.exp(1j * phase)))
        place.imshow(wrapped, origin="lower", extent=(-half_mm, half_mm, -half_mm, half_mm), cmap="twilight")
        place.set(title=f"helix phase, {name}", xlabel="x / mm")


def orientation(place: plt.Axes, summary: dict[str, Any]) -> None:
    """Orientation over depth: written file, target phases, and the law of rotation."""
    psf, phase = summary["psf"], summary["phase"]
    depth_cm = 100.0 * np.array(psf["depth_m"])
    place.plot(depth_cm, np.unwrap(psf["phi_deg"], period=360.0), "o", label="written file")
    place.plot(depth_cm, np.unwrap(psf["ideal_phi_deg"], period=360.0), "x", label="target phases")
    fine = np.linspace(depth_cm[0], depth_cm[-1], 101)
    turned = phase["rotation_deg_per_dioptre_theory"] * 100.0 * (1.0 / fine - 1.0 / depth_cm[0])
    place.plot(fine, psf["ideal_phi_deg"][0] + turned, label="law of rotation")
    place.set(title="orientation φ(z)", xlabel="depth / cm", ylabel="degrees")
    place.legend()


def rivals(place: plt.Axes, compared: Comparison) -> None:
    """Error of depth of textured planes: this design, standard lenses and the double helix, with their bounds."""
    for name, error, bound in zip(compared.methods, compared.error, compared.bound, strict=True):
        (line,) = place.semilogy(100.0 * compared.depth_m, 100.0 * error, "o-", markersize=3, label=name)
        place.semilogy(100.0 * compared.depth_m, 100.0 * bound, ":", color=line.get_color(), linewidth=1.0)
    place.plot([], [], ":", color="0.5", label="bound of each")
    place.set(title="depth of textured planes, rms error / %", xlabel="object depth / cm")
    place.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)


def efficiency(place: plt.Axes, merit: dict[str, Any]) -> None:
    """Light through the pinhole over depth: target phases, written file, and the paper's made lens."""
    depth_cm, measured = 100.0 * np.array(merit["depth_m"]), merit["measured"]
    for name, style in (("x", "o-"), ("y", "x--")):
        place.plot(
            depth_cm, merit[f"ideal_pinhole_efficiency_{name}"], style, color="0.6", label=f"target phases, {name}"
        )
        place.plot(
            depth_cm, merit[f"pinhole_efficiency_{name}"], style, color="tab:blue", label=f"written file, {name}"
        )
        place.axhline(measured[f"efficiency_{name}"], color="tab:red", linestyle=style[1:], label=f"made lens, {name}")
    place.set(title="efficiency through a pinhole of 100 µm", xlabel="object depth / cm", ylim=(0.0, 1.0))
    place.legend(ncols=3, loc="lower center", frameon=False)


def scene(places: np.ndarray, run: Path, nmae: float) -> None:
    """Decoded images, contrast and depth."""
    with h5py.File(run / "decoded.h5") as file:
        shown = [file[name][:] for name in ("intensity_x", "intensity_y", "contrast", "depth_m")]
    bright = np.nanpercentile(shown[0], 99.8)
    colours = ("gray", "gray", "viridis", "viridis")
    limits = ((0.0, bright), (0.0, bright), (0.5, 3.0), (None, None))
    titles = ("I_x", "I_y", "I_x / I_y", f"depth / m, NMAE {nmae:.2%}")
    for place, values, title, (low, high), colour in zip(places, shown, titles, limits, colours, strict=True):
        drawn = place.imshow(values, origin="lower", vmin=low, vmax=high, cmap=colour)
        place.set(title=title, xticks=[], yticks=[])
        plt.colorbar(drawn, ax=place, shrink=0.6)


def others(places: np.ndarray, runs: Path, names: list[str]) -> None:
    """Image and depth of the other scenes, with the error of those whose run has a summary."""
    for place, at, name in zip(places[::2], places[1::2], names, strict=True):
        with h5py.File(runs / name / "decoded.h5") as file:
            # The image is upside down.
            light, depth_m = (file[key][:][::-1, ::-1] for key in ("intensity_x", "depth_m"))
        place.imshow(light, origin="lower", vmin=0.0, vmax=np.nanpercentile(light, 99.8), cmap="gray")
        drawn = at.imshow(depth_m, origin="lower", cmap="viridis")
        plt.colorbar(drawn, ax=at, shrink=0.6)
        summary = runs / name / "summary.json"
        error = f", NMAE {_json(summary)['decode']['nmae']:.2%}" if summary.is_file() else ""
        place.set(title=f"{OTHERS[name]}: I_x", xticks=[], yticks=[])
        at.set(title=f"depth / m{error}", xticks=[], yticks=[])


def _json(path: Path) -> dict[str, Any]:
    table: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return table


if __name__ == "__main__":
    main()
