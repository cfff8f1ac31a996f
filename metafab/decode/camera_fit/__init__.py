"""Calibration of a camera from photographs of a point on the axis.

- ``point``    fit of the predicted PSF to one image of a point: RawFrame -> PointImage
- ``pinhole``  PointImages at several depths -> CameraFit and the calibrated Psf
"""
