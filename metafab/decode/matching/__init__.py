"""Matching: the cost volume of the twin images over candidate depths, and the depth of each pixel.

- ``levels``          brightness, noise and texture of a frame
- ``filters``         matched filters of each candidate depth, in a low-rank basis: spectra -> CostVolume
- ``filter_basis``    that basis: a few dozen kernels
- ``centring``        shift of the filters that keeps filtered textures in their place
- ``space_variance``  correction of the filters for the pair's change over the field
- ``bias``            correction of the filters for the bias of the correlation's maximum
- ``mixing``          products of the filtered twins, mixed block by block from the basis
- ``cost_volume``     CostVolume: products of the twins over place and candidate depth, and their correlation
- ``pooling``         means over windows, sums over labels
- ``semi_global``     costs of the levels of all pixels, changes from pixel to pixel included
- ``depth``           CostVolume -> PixelDepth: parabolic peak of the correlation, with its standard error
"""
