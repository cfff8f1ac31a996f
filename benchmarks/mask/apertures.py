"""Lenses of up to 20 mm and more by the command line: processor time and memory of layout, rules and PSF by aperture.

The paper's lens with a larger aperture, OASIS alone, one worker; the library is that of its unit cell, built if it is
not there. ``--only`` names apertures in um: 20000 has 2600 million pillars and takes 20 minutes of processor time and
9 GB of disk in the temporary folder. 8000.gds is the lens of 8 mm in GDSII, of 26 GB. ``error`` is the rms phase
error of the layout (rad), the number of violations found in the written file, and the error that a PSF states.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.pipeline.commands import REPOSITORY, finished
from metafab.core.errors import InputError

APERTURES_UM = ("2000", "4000", "8000")
#: Depth (m) and pixel (um) of the PSFs where the sensor is sharp, and far from there.
_PSFS = {"psf": ("0.3", "2"), "psf out of focus": ("0.1", "1")}
#: The same above 8 mm, whose finest fringes have a period below 1 um.
_LARGE_UM, _LARGE_PSFS = 8000.0, {"psf": ("0.3", "0.4"), "psf out of focus": ("inf", "0.4")}


def rows(quick: bool, only: Sequence[str] = ()) -> Iterator[dict[str, Any]]:
    """A row of each step and aperture; ``only`` names apertures in um. InputError for a name that is none."""
    for case in only:
        if not re.fullmatch(r"[1-9]\d*(\.(oas|gds))?", case):
            expected = "an aperture in whole um, with .gds or .oas after it if need be"
            raise InputError.single("benchmark", "--only", expected, repr(case))
    for case in only or (APERTURES_UM[:1] if quick else APERTURES_UM):
        aperture_um, _, suffix = case.partition(".")
        with TemporaryDirectory() as name:
            yield from _lens(float(aperture_um), suffix or "oas", Path(name))


def lens_of(aperture_um: float, folder: Path, suffix: str = "oas") -> Path:
    """Write the design of the paper's lens with another aperture and one format; its library is built if need be."""
    library = REPOSITORY / "unitcell_lib" / "sos_800nm.h5"
    if not library.is_file():
        _require(finished("library", "build", str(library.with_suffix(".toml")), "-o", str(library)).code, "library")
    text = (REPOSITORY / "layouts" / "helix_2mm.toml").read_text(encoding="utf-8")
    changes = {"library": f'"{library.as_posix()}"', "aperture_um": str(aperture_um), "formats": f'["{suffix}"]'}
    for key, value in changes.items():
        text, count = re.subn(rf"(?m)^{key} = .*$", f"{key} = {value}", text)
        if count != 1:
            raise RuntimeError(f"`{key}` is no longer once in the design that the benchmark changes")
    design = folder / "lens.toml"
    design.write_text(text, encoding="utf-8")
    return design


def _lens(aperture_um: float, suffix: str, folder: Path) -> Iterator[dict[str, Any]]:
    """Rows of one aperture."""
    design, mask = lens_of(aperture_um, folder, suffix), folder / f"layout.{suffix}"
    read, one_worker = (str(mask), "--design", str(design)), ("--workers", "1")
    psfs = _LARGE_PSFS if aperture_um > _LARGE_UM else _PSFS
    commands = {
        "layout": ("layout", str(design), "-o", str(folder), *one_worker),
        "rules": ("drc", *read, "-o", str(folder / "rules"), "--engine", "lattice", *one_worker),
        **{
            name: ("psf", *read, "-o", str(folder / "psf.h5"), "--depths-m", depth_m, "--pixel-um", pixel_um)
            for name, (depth_m, pixel_um) in psfs.items()
        },
    }
    for name, arguments in commands.items():
        done = finished(*arguments, "--json", most_s=36_000)
        _require(done.code, f"{name}: {done.stderr}")
        found = json.loads(done.stdout)
        yield {
            "name": f"{name}, {aperture_um / 1e3:g} mm",
            "series": f"{name}, {suffix}",
            "error": _error(found),
            "seconds": done.processor_seconds,
            "peak_rss_mb": done.peak_rss_mb,
            "wall_s": done.seconds,
            "bytes": mask.stat().st_size,
        } | {key: found[key] for key in ("pillars",) if key in found}


def _error(found: Mapping[str, Any]) -> float:
    """Error of a command's answer."""
    if "violations" in found:
        return float(sum(found["violations"].values()))
    return float(found["error"][0] if "error" in found else found["phase_rms_error_rad"])


def _require(code: int, of: str) -> None:
    if code:
        raise RuntimeError(f"exit {code} of {of}")
