"""Findings of the rules: counts of all violations, places of the first."""

from __future__ import annotations

import weakref

import numpy as np

from metafab.drc.report import MARKERS, Findings


def test_findings_keep_the_first_places_and_none_of_the_others() -> None:
    """Three arrays of 600 boxes: all are counted, the first 1000 shown, and no array is held as a whole."""
    findings, arrays = Findings(["foreign"]), [np.full((600, 4), float(number)) for number in range(3)]
    for boxes in arrays:
        findings.add("foreign", boxes)
    findings.add("foreign", np.empty((0, 4)), 7)
    assert findings.counts == {"foreign": 1807}
    shown = [marker.x_nm for marker in findings.markers()["foreign"]]
    assert shown == 600 * [0.0] + (MARKERS - 600) * [1.0]
    held = [weakref.ref(boxes) for boxes in arrays]
    del arrays, boxes
    assert [array() for array in held] == 3 * [None]
