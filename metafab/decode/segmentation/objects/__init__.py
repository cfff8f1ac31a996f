"""Objects that the segments of textured pixels miss: small and narrow ones before a surface, and plain ones.

- ``null_channel``   difference of the twins in which a surface vanishes, and the evidence of light before it
- ``object_window``  images, pair and texture about a small object
- ``object_scene``   images of a rectangle or an ellipse before a surface, with occlusion, and their slopes
- ``object_solver``  least squares for their textures and unknowns, and the posterior
- ``object_fit``     depth of a rectangle or an ellipse before a surface, by that model
- ``small_objects``  rectangles and ellipses of light before a segment, by ascent of their evidence
- ``bars``           straight bars narrower than a window before a segment, by ridges of its misfit
- ``plain_objects``  objects without texture, by the depth of their outlines
- ``plain_parts``    wide parts of segments whose twins show no depth
- ``plain_behind``   plain parts of objects that are the plain surface behind them
- ``plain_edges``    light of pixels at the edge of a plain surface: the surface's, or that of the object before it
"""
