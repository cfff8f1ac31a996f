"""Decoded images against the truth, and the smallest error of depth that a calibration allows.

- ``metrics``  an Image4D and its frame's truth -> errors of depth, contrast and images
- ``bound``    a Calibration and a texture -> the Cramer-Rao bound of depth at each place
"""
