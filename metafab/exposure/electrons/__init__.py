"""The electron beam in the resist.

- ``beam``         BeamPsf: the beam's point-spread function as a sum of Gaussians
- ``monte_carlo``  electrons in a stack of layers: radial energy density in the resist
- ``process``      point-spread function of a design's ``[process.exposure]``, and those of usual processes

In: a stack of layers, or a design's process. Out: a :class:`~metafab.exposure.electrons.beam.BeamPsf`.
"""
