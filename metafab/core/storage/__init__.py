"""Files.

- ``files``         atomic writing, JSON, fingerprints, cache of one file
- ``lock``          locks on folders and files
- ``limits``        limits on what reading one file may take
- ``tables``        conversion of JSON tables to dataclasses
- ``hdf5``          HDF5 with units, descriptions, provenance and a checksum
- ``pictures``      reader of grey pictures
- ``scratch``       arrays in files instead of memory
- ``provenance``    fingerprints of source code and of named files
- ``rerun``         answer of a run whose files are unchanged
- ``source_graph``  import graph of the package
"""
