"""Keys of a design that turned pillars and full-Stokes imaging do not support."""

from __future__ import annotations

from metafab.core.errors import Fault, InputError
from metafab.spec.design import Design
from metafab.spec.terms import SplitLens


def require_turnable(design: Design) -> None:
    """Refuse a design that turned pillars or a full-Stokes lens cannot follow: InputError with all keys at fault."""
    cell, rules, mask = design.unit_cell.cell, design.rules, design.mask
    unavailable = {
        "unit_cell.cell.shape": cell.shape != "rectangle",
        "rules.gap_rule": rules.gap_rule != "each",
        "rules.cd_sigma_nm": rules.cd_sigma_nm > 0.0,
        "rules.neighbours": rules.neighbours,
        "rules.polarisation_independent": rules.polarisation_independent,
        "rules.retardance": rules.retardance != "auto",
        "mask.tone": mask.tone == "inverted",
        "mask.draw_corners": mask.draw_corners and bool(cell.corner_radius_nm),
        "substrate": design.substrate is not None,
        "light": bool(design.light),
    }
    if design.optics is not None:
        unavailable["optics.filter_fwhm_nm"] = design.optics.filter_fwhm_nm is not None
        unavailable["optics.substrate_um"] = design.optics.substrate_um > 0.0
        unavailable["optics.oblique"] = design.optics.oblique is True
    for number, term in enumerate(design.phase):
        unavailable[f"phase[{number}].term"] = term.deflects and not isinstance(term, SplitLens)
        unavailable[f"phase[{number}].object_depth_m"] = isinstance(term, SplitLens) and term.object_depth_m is not None
    if design.scene is not None and any(item.moves for item in design.scene.objects):
        unavailable["scene.exposure_s"] = design.scene.exposure_s > 0.0
        unavailable["scene.row_time_s"] = design.scene.row_time_s > 0.0
    faults = [Fault(key, "not available with turned pillars", "") for key, used in unavailable.items() if used]
    if design.split_angle_deg == 0.0:
        faults.append(Fault("phase", "a `split_lens` of more than 0 degrees, which sets the images apart", "none"))
    if faults:
        raise InputError(design.name, faults)
