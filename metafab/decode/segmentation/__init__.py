"""Segmentation: connected pixels of one plane, and the depth of each segment from all of its pixels.

- ``prepared_frame``  PreparedFrame: registered twins, their spectra, masks of light and texture
- ``planes``          tilted planes through cells of a segment: least median of squares, RANSAC
- ``slopes``          tilted planes measured along themselves, which corrects their slopes
- ``outlines``        refinement of outlines by threshold dynamics
- ``layered``         model of the frame with occlusion: outlines that explain it
- ``fit``             null energy of the twins by place: whether a segment explains its pixels
- ``robust_fits``     planes and quadrics through the depths of pixels
- ``continuous``      continuous surfaces: a depth for each pixel, and its doubt
- ``objects``         objects that the segments of textured pixels miss: small ones, plain ones; plain parts
- ``segments``        SegmentDepth, and Regions: all segments of a frame
- ``layers``          depths at which many pixels lie, and connected pixels of one layer
- ``segment_depth``   the depth of a segment, measured on its interior
- ``fragments``       small segments that belong to a larger neighbour
- ``assignment``      pixels assigned to planes: segments and their depths
- ``surfaces``        the layers, planes or continuous surfaces that fit the pixels' depths best
- ``regions``         CostVolume and PixelDepth -> Regions: the whole way, with bars, small objects, outlines, doubt
"""
