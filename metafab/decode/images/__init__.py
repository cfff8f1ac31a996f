"""All-in-focus images, their contrast, and the 4D image put together.

- ``deconvolution``      Wiener deconvolution, tile by tile, at the depth of each pixel
- ``unmixing``           separation of the polarisations that a birefringent substrate mixes
- ``highlights``         saturated pixels and highlights about them, apart from the rest of a tile
- ``surface_edges``      continuous surfaces matched once more, with jumps at edges of the light
- ``contrast_outlines``  outlines between segments of unlike contrast, moved to where the contrast changes
- ``light_outlines``     outlines moved to edges of the light, where the model of the frame agrees
- ``shortest_outlines``  outlines shortened as far as the doubt about their pixels allows, along edges of the light
- ``frame_outlines``     outlines between unlike contrasts to a part of a downsampled pixel, by the raw frame
- ``pixel_outlines``     outlines between the downsampled pixels of segments, on the frame's pixels
- ``own_depths``         doubt of segments whose pixels, away from outlines, are seen at other depths
- ``contrast``           I_x / I_y of pixels and segments, with standard errors
- ``compose``            PixelDepth, Regions and sharp images -> Image4D
"""
