"""Energy that a pattern of pillars receives from the beam.

- ``near``    energy of the 3 x 3 nearest pillars, in closed form
- ``far``     energy from farther pillars, by Fourier transforms
- ``shapes``  pillars and polygons as sums of rectangles
- ``beside``  energy from everything else that is exposed: other lenses, frame, text, test structures
- ``resist``  ResistEnergy: energy at every pillar of a lens, tile by tile, and as a direct sum

In: a :class:`~metafab.layout.pillars.PillarMap` and a beam. Out: energies relative to that of a large pad at dose 1.
"""
