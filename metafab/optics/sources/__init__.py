"""The field that leaves the metasurface."""
