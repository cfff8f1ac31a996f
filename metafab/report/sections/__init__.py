"""Sections of the page: each function takes the opened run and the drawn figures (SVG by name) and returns HTML.

- ``overview``    subtitle, headlines, loss chain and error budget; time, memory, skipped steps, versions, files
- ``light``       PSF pair over depth and field, figures of merit, fabrication errors
- ``images``      raw frame and decoded image, comparison with other cameras
- ``device``      target phases, mask, exposure, full-wave simulations, library

A section whose files are missing says so in one line.
"""
