"""Field behind the metasurface.

- ``source``    the written pillars through their library, or the target phases; a stop and an amplitude in their plane
- ``measured``  pillars with sizes from a table, as from electron micrographs
"""
