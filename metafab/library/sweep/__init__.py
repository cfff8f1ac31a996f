"""Building a library: adaptive sampling over sizes and axes, with checkpoints.

- ``checkpoint``        solved points on disk as they arrive
- ``adaptive_sampling`` rounds of solving over the grid of sizes
- ``off_grid``          further sizes between those of the grid, where models disagree or amplitudes are steep
- ``corner_sampling``   rounds of solving over sizes and axes together
- ``build``             UnitCell -> Library, in memory or as a file, and the expected cost

In: a UnitCell, a solver and an executor. Out: a :class:`~metafab.library.library.Library`.
"""
