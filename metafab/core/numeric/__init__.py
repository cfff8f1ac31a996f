"""Numerics that several rooms share.

- ``compiled``        compilation of kernels by numba
- ``lanes``           complex arithmetic on eight independent problems at a time
- ``splines``         interpolating splines as weights of the values at their nodes
- ``bicubic_spline``  bicubic splines on tiles, and their errors
- ``bilinear``        bilinear interpolation on a centred grid
- ``chebyshev``       interpolation between Chebyshev points
- ``phasor``          exp(i phase) of many phases
- ``peaks``           maxima between samples
- ``spectra``         discrete Fourier transforms of kernels and filters
- ``distance``        exact Euclidean distance transform
"""
