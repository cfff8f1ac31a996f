"""Training of the model of neighbours: a library in, its :class:`~metafab.library.neighbours.model.Neighbours` out.

- ``training``  :func:`train`: rows and blocks are solved, chains fitted and measured
- ``growth``    fits of a chain in stages of more modes and more rows, and rows where it is least sure
- ``fit``       least-squares fit of a chain to solved rows
- ``row_sets``  solved rows by length, and their weights in a fit
- ``held_out``  errors of a chain on rows that are held out of its fit
"""

from metafab.library.neighbours.training.training import inputs_of_fits, inputs_of_rows, inputs_of_training, train

__all__ = ["inputs_of_fits", "inputs_of_rows", "inputs_of_training", "train"]
