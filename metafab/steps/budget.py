"""What the steps add up to: the error budget."""

from __future__ import annotations

from typing import Any

from metafab.core.storage.files import file_sha256
from metafab.steps.job import Job
from metafab.steps.layout import mask_paths

#: Sources that only a photograph meets.
_OF_IMAGES = {"depth interpolation", "field interpolation", "decoder"}
#: Sources that only pillars have.
_OF_PILLARS = {
    "solver and library", "size snapping and finite library", "index of the pillar", "local-period approximation",
}  # fmt: skip


def recorded_coupling(job: Job) -> dict[str, Any]:
    """What ``metafab coupling`` found on a mask of this run, {} if nothing."""
    if not (job.folder / "coupling.json").is_file():
        return {}
    from metafab import fullwave

    found = fullwave.load_coupling(job.folder / "coupling.json")
    if found is None or found.mask_sha256 not in {file_sha256(path) for path in mask_paths(job)}:
        return {}
    return {
        "coupling_error": found.coupling_error,
        "efficiency_ratio": found.efficiency_ratio,
        "rows": len(found.rows),
        "solvers": sorted({row.solver for row in found.rows}),
    }


def error_budget(figures: dict[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """The measured contributions to the error of the whole, in the order of the pipeline.

    Args:
        figures: each step's part of the summary, and ``coupling``, where it was measured.

    Returns:
        One row a source: ``source``, ``value`` (None where this run did not measure it), ``unit``, ``how``. A device
        without a scene has no images, one without a mask no pillars, whose errors are left out.
    """
    solved, written, light, decoded = (figures[name] for name in ("library", "layout", "psf", "decode"))
    rows = [
        _row("solver and library", solved.get("max_error"), "complex t", "largest error of any size: certificate of "
             "the truncation plus interpolation, checked at held-out sizes"),
        _row("size snapping and finite library", written.get("phase_rms_error_rad"), "rad rms",
             "phase of the chosen size against the target, over all pillars"),
        _row("index of the pillar", solved.get("index_phase_error_rad"), "rad rms",
             "phases solved again with the index raised by its standard uncertainty, common phase taken out"),
        _row("local-period approximation", figures.get("coupling", {}).get("coupling_error"), "relative L2",
             "field behind rows of one local period, full-wave, against the stitched library; `metafab coupling`"),
        _row("pupil reduction and sampling", max(light["error"]), "relative L2", "PSF with blocks of half the size"),
        _row("depth interpolation", light["depth_interpolation_error"], "relative L2",
             "PSFs computed at the verified depths against those interpolated from the other nodes"),
        _row("field interpolation", light["field_interpolation_error"], "relative L2",
             "PSF computed in the middle of an outermost cell of field points against the interpolated one"),
        _row("decoder", decoded.get("nmae"), "mean |dz|/z", "decoded against true depth of the simulated scene"),
    ]  # fmt: skip
    absent = (set() if decoded else _OF_IMAGES) | (set() if written else _OF_PILLARS)
    return [row for row in rows if row["value"] is not None or row["source"] not in absent]


def _row(source: str, value: float | None, unit: str, how: str) -> dict[str, Any]:
    return {"source": source, "value": value, "unit": unit, "how": how}
