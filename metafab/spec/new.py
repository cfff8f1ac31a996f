"""Commented sample design for each kind of device, with the sample files that it needs."""

from __future__ import annotations

import math
import os
import re
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from string import Template

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.storage.files import whole_file
from metafab.spec.cell import UnitCell
from metafab.spec.device import LARGEST_APERTURE_UM
from metafab.spec.keys.reference import near
from metafab.spec.load import load_unit_cell_of

_WRITE_FIELD_PM, _DIVISIBLE = 500_000_000, 12

_UNIT_CELL = "sos_800nm.toml"
#: Names that a design may have (:data:`metafab.spec.fields.Name`), without dots, behind which the file would end.
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")


def kinds() -> dict[str, str]:
    """Kinds of device, each with a one-line description."""
    files = resources.files("metafab.spec") / "kinds"
    texts = {item.name: item.read_text(encoding="utf-8") for item in files.iterdir() if item.name.endswith(".toml")}
    return {name.removesuffix(".toml"): _title(texts[name]) for name in sorted(texts)}


@dataclass(frozen=True)
class NewLens:
    """Aperture of a new metalens."""

    numerical_aperture: float = 0.2  #: In air, above 0 and below 1.
    aperture_um: float = 100.0  #: Diameter.

    def filled(self, unit_cell: UnitCell) -> dict[str, str]:
        """Return the placeholders of the kind "metalens": focal length, pixel and rules that fit the unit cell.

        An aperture out of range raises InputError.
        """
        if not 0.0 < self.numerical_aperture < 1.0:
            got = f"{self.numerical_aperture:g}"
            raise InputError.single("new", "numerical_aperture", "above 0 and below 1 (the lens focuses in air)", got)
        least_um = 1e-3 * max(unit_cell.cell.period_nm)
        if not least_um <= self.aperture_um <= LARGEST_APERTURE_UM:
            expected = f"one period, {least_um:g}, to {LARGEST_APERTURE_UM:g}"
            raise InputError.single("new", "aperture_um", expected, f"{self.aperture_um:g}", "the unit is um")
        focal_um = 0.5 * self.aperture_um / math.tan(math.asin(self.numerical_aperture))
        spans_nm = unit_cell.sweep.width_nm, unit_cell.sweep.length_nm
        gap_nm = min(period - high for period, (_, high) in zip(unit_cell.cell.period_nm, spans_nm, strict=True))
        feature_nm = min(low for low, _ in spans_nm)
        if hole_nm := unit_cell.cell.hole_nm(feature_nm):
            feature_nm, gap_nm = 0.5 * (feature_nm - hole_nm), min(gap_nm, hole_nm)
        pixel_um = 1e-3 * unit_cell.illumination.wavelength_nm / (8.0 * self.numerical_aperture)
        return {
            "numerical_aperture": f"{self.numerical_aperture:g}",
            "aperture_um": f"{self.aperture_um:.10g}" if self.aperture_um % 1.0 else f"{self.aperture_um:.1f}",
            "focal_length_mm": f"{1e-3 * focal_um:.6g}",
            "pixel_um": f"{pixel_um:.3g}",
            # Sizes up to the period leave no gap between equal pillars; the usual rule then limits them.
            "min_gap_nm": f"{gap_nm if gap_nm > 0.0 else 100.0:.1f}",
            "min_feature_nm": f"{feature_nm:.1f}",
        }


def write_new(
    name: str, kind: str, folder: Path, library: Path | None = None, lens: NewLens | None = None
) -> tuple[Path, ...]:
    """Write ``folder/name.toml`` and the sample files of its kind; return the files, the design first.

    Args:
        name: design name; letters, digits, ``_`` and ``-``, as a design may have it.
        kind: one of :func:`kinds`.
        folder: output folder, created if missing.
        library: unit-cell file or built library; None for the paper's: that in ``unitcell_lib`` of the folder or of a
            folder above it, else a copy that is written beside the design.
        lens: aperture, for the kind "metalens"; None for its default.

    Raises:
        InputError: an unknown kind, an unfit name, a missing or faulty unit cell, or a file that is there already
            (nothing is overwritten).
    """
    if kind not in kinds():
        raise InputError.single("new", "kind", f"one of {', '.join(kinds())}", repr(kind), near(kind, kinds()))
    if not _NAME.fullmatch(name):
        expected = "up to 64 of a-z, A-Z, digits, _ and -, a letter or digit first"
        raise InputError.single("new", "name", expected, repr(name), "the file's ending is added")
    supplied = resources.files("metafab.spec") / "unit_cells" / _UNIT_CELL
    known = _unit_cell_near(folder) if library is None else library
    unit_cell = folder / _UNIT_CELL if known is None else known
    with resources.as_file(supplied) as copy:
        cell = load_unit_cell_of(copy if known is None else known)
    if lens is not None and kind != "metalens":
        raise InputError.single("new", "lens", "the kind metalens", repr(kind), "edit the file instead")
    text = (resources.files("metafab.spec") / "kinds" / f"{kind}.toml").read_text(encoding="utf-8")
    relative = Path(os.path.relpath(unit_cell.resolve(), folder.resolve())).as_posix()
    sample = {"hologram": folder / f"{name}.png", "own_phase": folder / f"{name}.npy"}.get(kind)
    design = folder / f"{name}.toml"
    written = [design] if sample is None else [design, sample]
    for path in written:
        if path.exists():
            remedy = "choose another name, or move it away"
            raise InputError.single(str(path), "file", "a name that is free", "a file", remedy)
    places = {"name": name, "library": relative, "write_field_um": f"{write_field_um(cell):.10g}"}
    filled = Template(text).substitute(places | (lens or NewLens()).filled(cell))
    if known is None:
        with whole_file(unit_cell) as part:
            part.write_bytes(supplied.read_bytes())
        written.insert(1, unit_cell)
    if sample is not None:
        with whole_file(sample) as part:
            _write_sample(part, kind)
    with whole_file(design) as part:
        part.write_text(filled, encoding="utf-8")
    return tuple(written)


def write_field_um(unit_cell: UnitCell) -> float:
    """Side of a write field near 500 um: a whole number of periods along x and y with many divisors.

    On a hexagonal lattice only the period along the rows counts.
    """
    cell = unit_cell.cell
    periods_pm = [round(1e3 * period_nm) for period_nm in cell.period_nm[: 1 if cell.is_hexagonal else 2]]
    step_pm = math.lcm(*periods_pm)
    # A count with many divisors, if one is near: tiles divide a field evenly.
    several = _DIVISIBLE if _DIVISIBLE * step_pm <= _WRITE_FIELD_PM else 1
    return 1e-6 * several * step_pm * max(1, round(_WRITE_FIELD_PM / (several * step_pm)))


def sample_picture(rows: int = 240) -> FloatArray:
    """Test picture with a ring, bars and a grey wedge: shape (rows, rows), 0 to 1, first row at the top."""
    y, x = np.meshgrid(*2 * [(np.arange(rows) + 0.5) / rows * 2.0 - 1.0], indexing="ij")
    radius = np.hypot(x, y)
    picture = np.where((radius > 0.8) & (radius < 0.92), 1.0, 0.0)
    bars = (np.abs(y + 0.35) < 0.2) & (np.abs(x) < 0.5) & (np.floor(6.0 * (x + 0.5)) % 2 == 0)
    wedge = (np.abs(y - 0.25) < 0.2) & (np.abs(x) < 0.6)
    return np.where(bars, 1.0, np.where(wedge, 0.5 + x / 1.2, picture))


def _write_sample(path: Path, kind: str) -> None:
    """Write the picture of a hologram, or a cubic phase (Dowski and Cathey, Appl. Opt. 34, 1859, 1995) of 100 um."""
    if kind == "hologram":
        from PIL import Image

        Image.fromarray(np.round(255.0 * sample_picture()).astype(np.uint8)).save(path, format="png")
        return
    axis = np.linspace(-1.0, 1.0, 202)
    with path.open("wb") as file:
        np.save(file, 15.0 * (axis[:, None] ** 3 + axis**3))


def _title(text: str) -> str:
    """First sentence of the comment at the top of a design file."""
    lines = []
    for line in text.splitlines():
        if not line.startswith("#") or line.startswith("# Run it with"):
            break
        lines.append(line.removeprefix("#").strip())
    return " ".join(lines).split(". ")[0].rstrip(".")


def _unit_cell_near(folder: Path) -> Path | None:
    here = folder.resolve()
    places = (*(place / "unitcell_lib" / _UNIT_CELL for place in (here, *here.parents)), here / _UNIT_CELL)
    return next((place for place in places if place.is_file()), None)
