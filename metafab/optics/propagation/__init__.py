"""Propagation from the pillars to irradiance on a window of the sensor.

- ``pupil``    Pupil: block sums of the pillars, in one streaming pass
- ``refocus``  block sums behind another ray: other depths, directions, wavelengths
- ``kernel``   kernel of one window: a separable transform times a low-rank rest
- ``window``   block sums to the field on a window, by matrix Fourier transforms
- ``image``    irradiance on a window and its error; large windows in panels
- ``band``     irradiance over the band of a filter
- ``blocks``   block size for a target error

In: a :class:`~metafab.optics.sources.source.Source` and an :class:`~metafab.optics.geometry.imaging.Imaging`. Out:
irradiance and error of one polarisation and direction over depth.
"""
