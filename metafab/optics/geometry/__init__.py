"""Geometry of lens and sensor.

- ``aperture``      points of the aperture that carry equal power
- ``imaging``       Imaging: image points by the grating law, finest fringes, nodes over depth and field
- ``plate``         Plate: refraction by the substrate between scene and pillars
- ``crystal``       birefringent plate: Jones matrix of each ray
- ``path``          Ray: path lengths from object over lens to sensor, and incident amplitudes
- ``polarisation``  direction of E and H behind each site, and the focus of an ideal flat lens in closed form
"""
