"""Rational models of the amplitudes over pillar sizes, and the error bounds that follow from them.

- ``size_grid``   the manufacturable sizes, and the order in which they are solved
- ``rational``    amplitudes as N/D with common poles over sizes and axes, fitted to scattered samples
- ``models``      models of different degrees, ranked by held-out samples; their disagreement estimates the error
- ``certificate`` error bound of every size from model disagreement and solver errors

In: solved cells. Out: :class:`~metafab.library.fit.models.RankedModels` and error maps over the grid of sizes.
"""
