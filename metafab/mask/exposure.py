"""How long the e-beam writes, from what is drawn."""

from __future__ import annotations

from typing import Any

from metafab.spec import Exposure


def write_time(exposure: Exposure, area_um2: float, shapes: int, fields: int) -> dict[str, Any]:
    """Seconds of beam and of settling.

    The beam time is dose x area / current; a class of another dose scales its share of it. Blanking, alignment,
    stage moves beyond the settling and loading are the shop's to add.

    Args:
        exposure: dose, current and settling times.
        area_um2: exposed area.
        shapes: exposed shapes.
        fields: write fields that hold any.
    """
    micro_coulomb = exposure.dose_uc_per_cm2 * area_um2 * 1e-8
    beam_s = micro_coulomb / (exposure.beam_current_na * 1e-3)
    settling_s = shapes * exposure.settle_shape_us * 1e-6 + fields * exposure.settle_field_ms * 1e-3
    return {
        "area_um2": area_um2,
        "shapes": shapes,
        "fields": fields,
        "beam_seconds": beam_s,
        "settling_seconds": settling_s,
        "seconds": beam_s + settling_s,
    }
