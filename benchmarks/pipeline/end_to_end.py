"""Seconds and peak memory of each step of a run, for several apertures, numbers of depths and numbers of pixels.

The small camera is scaled: the focal length grows with the aperture, the depths with its square. The lobe then rotates
by the same angle, the images keep their pixels, and only the number of pillars changes. Depths and pixels are varied
for an aperture of 0.2 mm, over the same range and the same field of view.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from metafab.run import run
from metafab.spec import Design, load_design

SMALL = Path(__file__).parents[2] / "layouts" / "helix_small.toml"
QUICK_UM, FULL_UM = (100.0, 200.0), (100.0, 200.0, 500.0, 1000.0, 2000.0)
DEPTHS = (2, 8, 16)
#: Pixels along a line, relative to the 128 pixels of the small camera.
FINER = (0.5, 2.0)


def rows(quick: bool) -> list[dict[str, Any]]:
    """Rows of every step, and one for the whole run, whose ``error`` is the mean |dz| / z of the decoded depths.

    Args:
        quick: only apertures up to 0.2 mm.
    """
    small = load_design(SMALL)
    found = []
    for aperture_um in QUICK_UM if quick else FULL_UM:
        found += _job(scaled(small, aperture_um), f"{aperture_um / 1000.0:g} mm")
    if quick:
        return found
    for count in DEPTHS:
        found += _job(deeper(small, count), f"{count} depths")
    for share in FINER:
        found += _job(finer(small, share), f"{share:g} times the pixels a line")
    return found


def deeper(design: Design, count: int) -> Design:
    """The camera verified at ``count`` depths of the same range, evenly in vergence."""
    near_m, *_, far_m = design.verify.depths_m
    step = (1.0 / near_m - 1.0 / far_m) / (count - 1)
    depths_m = (near_m, *(1.0 / (1.0 / near_m - k * step) for k in range(1, count - 1)), far_m)
    return replace(design, name=f"{design.name}_{count}", verify=replace(design.verify, depths_m=depths_m))


def finer(design: Design, share: float) -> Design:
    """The camera with ``share`` times the pixels along each line, over the same field and the same windows."""
    scene = design.scene
    assert scene is not None  # the small camera has one
    field_px = (round(share * scene.field_px[0]), round(share * scene.field_px[1]))
    window_px = round(share * design.verify.window_px)
    return replace(
        design,
        name=f"{design.name}_{field_px[0]}px",
        sensor=replace(design.sensor, pixel_um=design.sensor.pixel_um / share),
        verify=replace(design.verify, window_px=window_px),
        scene=replace(scene, field_px=field_px),
    )


def scaled(design: Design, aperture_um: float) -> Design:
    """The camera scaled to another aperture."""
    share = aperture_um / design.device.aperture_um
    depth, angle = share**2, 1.0 / share
    scene = design.scene
    assert scene is not None  # the small camera has one
    objects = tuple(
        replace(
            item,
            depth_m=depth * item.depth_m,
            centre=(angle * item.centre[0], angle * item.centre[1]),
            size=(angle * item.size[0], angle * item.size[1]),
        )
        for item in scene.objects
    )
    return replace(
        design,
        name=f"helix_{aperture_um:g}um",
        device=replace(design.device, aperture_um=aperture_um, focal_length_mm=share * design.device.focal_length_mm),
        sensor=replace(design.sensor, focus_depth_m=depth * design.sensor.focus_depth_m),
        verify=replace(design.verify, depths_m=tuple(depth * z for z in design.verify.depths_m)),
        scene=replace(scene, objects=objects),
    )


def _job(design: Design, title: str) -> Iterator[dict[str, Any]]:
    with TemporaryDirectory() as folder:
        summary = run(design, Path(folder))
    shared = {
        "aperture_um": design.device.aperture_um,
        "pillars": None if summary.layout is None else summary.layout.pillars,
        "depths": len(design.verify.depths_m),
        "field_px": list(design.scene.field_px) if design.scene else None,
    }
    for step, seconds in summary.seconds.items():
        memory = summary.peak_rss_mb[step]
        yield {"name": f"{title}: {step}", "error": None, "seconds": seconds, "peak_rss_mb": memory, **shared}
    yield {
        "name": f"{title}: whole",
        "error": None if summary.decode is None else summary.decode.nmae,
        "seconds": sum(summary.seconds.values()),
        "peak_rss_mb": max(summary.peak_rss_mb.values()),
        **shared,
    }
