"""Figures of merit of a PSF stack and of a written mask.

- ``metrics``         main lobe, efficiency through a pinhole, rotation, depth of field
- ``mtf``             modulation transfer of the pair and of a standard lens
- ``focus``           widths, Strehl ratio and encircled energy of a lens beside the ideal flat lens
- ``aberrations``     wavefront behind a lens and its Zernike polynomials
- ``landing``         where light lands that misses its window
- ``chain``           losses from the aperture to the pinhole, factor by factor
- ``space_variance``  image points, aberrations and depth bias over the field of view
"""
