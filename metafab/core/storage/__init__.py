"""Files.

- ``files``         atomic writing, JSON, fingerprints, cache of one file
- ``tables``        conversion of JSON tables to dataclasses
- ``hdf5``          HDF5 with units, descriptions, provenance and a checksum
- ``pictures``      reader of grey pictures
- ``scratch``       arrays in files instead of memory
- ``provenance``    fingerprints of source code and of named files
- ``rerun``         answer of a run whose files are unchanged
- ``source_graph``  import graph of the package
"""
