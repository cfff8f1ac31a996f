"""The page's sections: accounts first, then light and image, then phases, mask and library, then what it cost.

Each function takes the opened run and the drawn figures (name -> SVG) and returns ready HTML; a section whose files
are missing says so in a line.

- ``overview``  device in a line, headlines
- ``accounts``  loss chain, error budget
- ``light``     PSF pair over depth and field
- ``imaging``   raw frame, decoded image
- ``comparison``  the design beside other cameras
- ``phases``    target phases, bounds of depth, colour filter
- ``mask``      pillars, files, design rules
- ``fullwave``  unlike neighbours
- ``library``   maps over the sizes
- ``cost``      seconds, memory, skipped steps, provenance
- ``parts``     what several sections use
"""

from metafab.report.sections.accounts import accounts
from metafab.report.sections.comparison import comparison
from metafab.report.sections.cost import cost, provenance
from metafab.report.sections.fullwave import fullwave
from metafab.report.sections.imaging import imaging
from metafab.report.sections.library import library
from metafab.report.sections.light import point_spread, tolerances
from metafab.report.sections.mask import mask
from metafab.report.sections.overview import headlines, subtitle
from metafab.report.sections.parts import Drawn
from metafab.report.sections.phases import phases

__all__ = [
    "Drawn",
    "accounts",
    "comparison",
    "cost",
    "fullwave",
    "headlines",
    "imaging",
    "library",
    "mask",
    "phases",
    "point_spread",
    "provenance",
    "subtitle",
    "tolerances",
]
