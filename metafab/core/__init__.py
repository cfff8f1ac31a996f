"""What every room stands on.

- ``conventions``  signs, axes, reference planes; array types
- ``errors``       faults and exit codes
- ``files``        whole files, JSON, fingerprints
- ``provenance``   hashes of code and of the files that a spec names
- ``pictures``     grey pictures that other programs wrote
- ``hdf5``         datasets with units, descriptions and scales
- ``executor``     processes or a Dask cluster behind one interface
- ``progress``     the callback by which long work reports
- ``numerics``     optional compilation (numba) behind one decorator
"""
