"""The gap rule and the other rules that limit sizes, on the mapped pillars."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab import layout
from metafab.core.errors import InputError
from metafab.layout.gap_rule import allowed_sizes
from metafab.library import Library
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Design
from tests.layout.conftest import sizes_at_sites


@pytest.mark.parametrize("min_gap_nm", [100.0, 130.0, 180.0])
def test_gaps_keep_the_rule(
    min_gap_nm: float, profile: PhaseProfile, smooth_library: Library, tiny_design: Design
) -> None:
    design = replace(tiny_design, rules=replace(tiny_design.rules, min_gap_nm=min_gap_nm))
    assignment = layout.assign(profile, smooth_library, design)
    # Measured independently of the mapping's own figure, on the finished map.
    found = layout.smallest_gap(
        assignment.pillars.to_array(), assignment.pillars.size_dbu, assignment.pillars.lattice, min_gap_nm / 0.5
    )
    assert found.below == 0
    assert found.smallest_dbu * 0.5 == pytest.approx(assignment.figures.min_gap_nm, rel=1e-12)
    assert assignment.figures.min_gap_nm >= min_gap_nm


def test_tall_pillars_keep_the_aspect_ratio(
    profile: PhaseProfile, smooth_library: Library, tiny_design: Design
) -> None:
    """600 nm at a ratio of 4 leave sides from 150 nm; 150 itself is on the grid of 2 nm and allowed."""
    design = replace(tiny_design, rules=replace(tiny_design.rules, max_aspect_ratio=4.0))
    size_nm = allowed_sizes(smooth_library, design).size_dbu[1:] * 0.5
    assert size_nm.min() == 150.0
    used_nm = sizes_at_sites(layout.assign(profile, smooth_library, design).pillars) * 0.5
    assert used_nm[used_nm > 0].min() >= 150.0


@pytest.mark.parametrize("rules", [{"max_aspect_ratio": 2.0}, {"min_gap_nm": 255.0}, {"min_feature_nm": 251.0}])
@pytest.mark.parametrize("gap_rule", ["each", "pairs"])
def test_rules_that_leave_no_size_are_refused(
    rules: dict[str, float], gap_rule: str, profile: PhaseProfile, smooth_library: Library, tiny_design: Design
) -> None:
    design = replace(tiny_design, rules=replace(tiny_design.rules, gap_rule=gap_rule, **rules))
    with pytest.raises(InputError, match="sizes that the rules allow"):
        layout.assign(profile, smooth_library, design)


def test_rules_may_ask_for_one_response_to_both_polarisations_and_for_calm_sizes(
    profile: PhaseProfile, smooth_library: Library, tiny_design: Design
) -> None:
    alike = replace(tiny_design, rules=replace(tiny_design.rules, polarisation_independent=True))
    sizes = layout.assign(profile, smooth_library, alike).pillars
    used = sizes.size_nm()[np.unique(sizes.to_array())]
    assert len(used) > 5
    assert np.array_equal(used[:, 0], used[:, 1])
    calm = replace(tiny_design, rules=replace(tiny_design.rules, cd_sigma_nm=20.0))
    tables = [allowed_sizes(smooth_library, design) for design in (tiny_design, calm)]
    assert np.any(tables[0].size_index != tables[1].size_index)


def test_a_single_pillar_has_no_gap(profile: PhaseProfile, smooth_library: Library, small_design: Design) -> None:
    design = replace(small_design, device=replace(small_design.device, aperture_um=0.5))
    figures = layout.assign(profile, smooth_library, design).figures
    assert figures.pillars == 1
    assert figures.min_gap_nm is None
