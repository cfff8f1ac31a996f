"""Numerics that several rooms share.

- ``compiled``        compilation of kernels by numba
- ``ahead``           compilation by further processes, while a run goes on
- ``lanes``           complex arithmetic on eight independent problems at a time
- ``lane_matrices``   symmetric matrices of these: inverse and product
- ``interpolation``   on a centred grid, by splines, and of a maximum between samples
- ``bicubic_spline``  bicubic splines on tiles, and their errors
- ``chebyshev``       interpolation between Chebyshev points
- ``phasor``          exp(i phase) of many phases
- ``spectra``         discrete Fourier transforms of kernels and filters
- ``conjugate_gradients``  their passes over the transforms of many pictures
- ``distance``        exact Euclidean distance transform
- ``spread``          standard deviation of samples with outliers
"""
