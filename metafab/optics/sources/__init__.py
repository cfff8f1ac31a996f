"""Field behind the metasurface.

- ``source``      the written pillars through their library, or the target phases; stop and amplitude in their plane
- ``neighbours``  field behind the pillars, each among its own neighbours
- ``oblique``     field behind pillars whose light depends on the direction from which it comes
- ``measured``    pillars with sizes from a table, as from electron micrographs
"""
