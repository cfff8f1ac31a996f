"""Which of two segmentations of a steep ground explains the twins better."""

from __future__ import annotations

from dataclasses import replace

from metafab.decode.segmentation.fit import explains_better
from metafab.decode.segmentation.regions import find_regions
from metafab.decode.segmentation.segments import Regions
from tests.steep_ground import matched, photographed


def test_as_many_segments_explain_better_only_by_depths_that_differ() -> None:
    prepared, volume, pixels = matched(*photographed())
    regions = replace(find_regions(prepared, volume, pixels), surface_per_m=None)  # planes alone

    def farther(share: float) -> Regions:
        planes = [replace(d.plane, vergence_per_m=d.plane.vergence_per_m * (1.0 - share)) for d in regions.depths]
        depths = (replace(d, plane=plane) for d, plane in zip(regions.depths, planes, strict=True))
        return replace(regions, depths=tuple(depths))

    assert explains_better(regions, farther(0.05), prepared, volume, pixels)
    assert not explains_better(farther(0.05), regions, prepared, volume, pixels)
    # One of the two leaves less of the twins, by chance.
    assert not any(explains_better(farther(share), regions, prepared, volume, pixels) for share in (-1e-4, 1e-4))
