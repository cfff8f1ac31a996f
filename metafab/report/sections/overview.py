"""The head of the page: the device in a line, and the few figures that matter most."""

from __future__ import annotations

from html import escape

from metafab.report import html
from metafab.report.run_folder import RunFolder


def headlines(run: RunFolder) -> str:
    """The few figures that matter most."""
    items = []
    nmae = run.part("decode").get("nmae")
    if nmae is not None:
        items.append(html.headline(f"{100 * nmae:.2g}\u202f%", "mean depth error", "good" if nmae < 0.01 else "bad"))
    rotation = run.part("phase").get("rotation_deg")
    if rotation is not None:
        items.append(html.headline(f"{abs(rotation):.0f}°", "turn of the pair over the design’s depths"))
    painted = run.part("phase").get("hologram_efficiency")
    if painted is not None:
        items.append(html.headline(f"{100 * painted:.0f}\u202f%", "of the light in the picture"))
    pillars = run.part("layout").get("pillars")
    if pillars is not None:
        items.append(html.headline(html.number(pillars), "pillars"))
    violations = run.part("drc").get("violations")
    if violations is not None:
        broken = sum(violations.values())
        items.append(html.headline(html.number(broken), "rules broken", "bad" if broken else "good"))
    seconds = run.part("seconds")
    if seconds:
        first, last = "unit cell" if run.has_mask else "target phases", "PSF" if nmae is None else "depth map"
        items.append(html.headline(f"{sum(seconds.values()):.3g}\u202fs", f"from {first} to {last}"))
    return f'<ul class="headlines">{"".join(items)}</ul>' if items else ""


def subtitle(run: RunFolder) -> str:
    """The device in a line."""
    device = run.design_table.get("device", {})
    cell = run.design_table.get("unit_cell", {})
    wavelength = cell.get("illumination", {}).get("wavelength_nm")
    parts = []
    if "aperture_um" in device:
        aperture = device["aperture_um"]
        size = f"{aperture / 1000:g} mm" if aperture >= 1000 else f"{aperture:g} µm"
        parts.append(f"{size} {device.get('aperture_shape', 'aperture')}")
    if "focal_length_mm" in device:
        parts.append(f"focal length {device['focal_length_mm']:g} mm")
    if wavelength is not None:
        parts.append(f"{wavelength:g} nm")
    terms = [str(term.get("term", "")).replace("_", " ") for term in run.design_table.get("phase", [])]
    return escape(" · ".join([*parts, " + ".join(terms)] if terms else parts))
