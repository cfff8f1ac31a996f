"""Foundations of every room.

- ``conventions``   signs, axes, units and reference planes, with the array types
- ``polarisation``  six states of polarisation, Stokes vectors
- ``errors``        faults, errors and their exit codes
- ``arguments``     arguments of a wrong type, refused in words
- ``further``       names that a face offers without listing them
- ``display``       results in a console, in a notebook, and as labelled arrays
- ``figures``       figures of the rooms that ``summary.json`` and their files hold
- ``numeric``       compilation by numba, and numerics that several rooms share
- ``parallel``      executors, worker processes, interrupts, progress, cost of a block
- ``storage``       atomic files, HDF5, pictures, fingerprints
"""
