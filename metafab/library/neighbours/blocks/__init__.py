"""Blocks of unlike pillars: the coupling of chains across their lines.

- ``lattice``   field of a block by chains that are coupled from line to line
- ``cross``     cross-polarised light of a block
- ``training``  blocks that are solved, and the coupling fitted to them
"""
