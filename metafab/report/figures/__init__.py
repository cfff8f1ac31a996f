"""Figure functions: each takes results and axes, draws, and returns the axes. No physics is computed here.

- ``library``   maps of phase, transmittance, sensitivity and error over pillar size; coverage of both phases
- ``phases``    phases over the aperture, picture of a hologram
- ``study``     main lobe over one turn, depth bounds, colour filter, proposals, comparison with other cameras
- ``mask``      the written mask at three zooms, fields of a simulated patch
- ``psf``       the pair over depth and field, orientation, peak, modulation transfer
- ``image``     raw frame, decoded intensities, contrast, depth, depth against truth
- ``accounts``  loss chain, error budget, seconds, error against time
"""
