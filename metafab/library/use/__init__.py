"""Using a library: sizes for target phases, figures of merit, and checks of its errors.

- ``lookup``       target phases -> size index, by the largest field overlap
- ``lights``       sizes for several lights together
- ``any_size``     response of pillars of any size, solved beyond the sweep
- ``quality``      phase coverage, transmittance, sensitivity to a bias of sizes
- ``check``        held-out sizes against a finer or another solver
- ``amplitudes``   power transmittance, amplitudes normalised to power, Jones matrices of turned pillars
- ``oblique``      change of the light that meets the pillars at an angle, and the error where it is left out
- ``error_terms``  error by the uncertainty of the pillar's index

In: a :class:`~metafab.library.library.Library`. Out: a :class:`~metafab.library.use.lookup.SizeTable` for the layout,
and figures.
"""
