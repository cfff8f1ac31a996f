"""Files: whole or absent, HDF5, pictures, fingerprints and the code that results depend on."""
