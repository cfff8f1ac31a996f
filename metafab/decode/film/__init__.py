"""Films: frames one after the other, of which only the parts that changed are decoded again.

- ``changes``         change detection between raw frames: RawFrame, RawFrame -> rectangles that changed
- ``surface_planes``  segments on the planes of a continuous surface: Regions -> Regions
- ``tracking``        segments of the last frame continued in the segments of a part
- ``video``           VideoDecoder: RawFrame after RawFrame -> Image4D after Image4D
"""
