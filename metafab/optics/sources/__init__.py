"""Field behind the metasurface.

- ``source``      the written pillars through their library, or the target phases
- ``apodisation``  a stop and an amplitude in the plane of the pillars
- ``measured``     pillars with sizes from a table, as from electron micrographs
"""
