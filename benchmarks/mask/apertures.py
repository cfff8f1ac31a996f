"""Lenses of up to 20 mm and more by the command line: processor time and memory of layout, rules and PSF by aperture.

The paper's lens with a larger aperture, OASIS alone, one worker; the library is that of its unit cell, built if it is
not there. ``--only`` names apertures in um: 20000 has 2600 million pillars and takes 25 minutes of processor time and
9 GB of disk in the temporary folder. ``error`` is the number of violations found in the written file.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.pipeline.commands import REPOSITORY, finished

APERTURES_UM = ("2000", "4000", "8000")
#: Extra arguments of each step; pixels of 2 um suit the focal spot of 8 mm at this focal length.
_STEPS = {
    "layout": (),
    "drc": ("--engine", "lattice"),
    "psf": ("--depths-m", "0.3", "--pixel-um", "2"),
}
#: Those of the PSF above 8 mm, um: at 0.3 m the light would fill more than the window, and 2 um be too coarse.
_LARGE_UM, _IN_FOCUS = 8000.0, ("--depths-m", "inf", "--pixel-um", "0.4")


def rows(quick: bool, only: Sequence[str] = ()) -> Iterator[dict[str, Any]]:
    """A row of each step and aperture; ``only`` names apertures in um."""
    library = REPOSITORY / "unitcell_lib" / "sos_800nm.h5"
    if not library.is_file():
        _require(finished("library", "build", str(library.with_suffix(".toml")), "-o", str(library)).code, "library")
    for aperture_um in only or (APERTURES_UM[:1] if quick else APERTURES_UM):
        with TemporaryDirectory() as name:
            yield from _lens(float(aperture_um), library, Path(name))


def _lens(aperture_um: float, library: Path, folder: Path) -> Iterator[dict[str, Any]]:
    """Rows of one aperture."""
    text = (REPOSITORY / "layouts" / "helix_2mm.toml").read_text(encoding="utf-8")
    changes = {"library": f'"{library.as_posix()}"', "aperture_um": str(aperture_um), "formats": '["oas"]'}
    for key, value in changes.items():
        text, count = re.subn(rf"(?m)^{key} = .*$", f"{key} = {value}", text)
        if count != 1:
            raise RuntimeError(f"`{key}` is no longer once in the design that the benchmark changes")
    design, mask = folder / "lens.toml", folder / "layout.oas"
    design.write_text(text, encoding="utf-8")
    for step, further in _STEPS.items():
        place = [str(design)] if step == "layout" else [str(mask), "--design", str(design)]
        output = ["-o", str(folder if step == "layout" else folder / f"{step}.out")]
        workers = [] if step == "psf" else ["--workers", "1"]
        extra = _IN_FOCUS if step == "psf" and aperture_um > _LARGE_UM else further
        done = finished(step, *place, *output, *extra, *workers, "--json", most_s=36_000)
        _require(done.code, f"{step}: {done.stderr}")
        found = json.loads(done.stdout)
        yield {
            "name": f"{step}, {aperture_um / 1e3:g} mm",
            "series": step,
            "error": float(sum(found["violations"].values())) if step == "drc" else None,
            "seconds": done.processor_seconds,
            "peak_rss_mb": done.peak_rss_mb,
            "wall_s": done.seconds,
            "bytes": mask.stat().st_size,
        } | {key: found[key] for key in ("pillars",) if key in found}


def _require(code: int, of: str) -> None:
    if code:
        raise RuntimeError(f"exit {code} of {of}")
