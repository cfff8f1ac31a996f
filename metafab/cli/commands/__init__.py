"""The commands; the list is in :mod:`metafab.cli`."""
