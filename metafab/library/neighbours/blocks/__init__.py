"""Blocks of unlike pillars: the coupling of chains across their lines.

- ``lattice``   field of a block by chains that are coupled from line to line
- ``training``  blocks that are solved, and the coupling fitted to them
"""
