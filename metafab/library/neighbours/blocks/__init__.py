"""Blocks of unlike pillars: the joint effect of their rows and columns.

- ``joint``     joint effect in a small block, by coarse spectral elements
- ``lattice``   field of a larger block by chains that are coupled from line to line
- ``cross``     cross-polarised light of a larger block
- ``training``  blocks that are solved, and the couplings fitted to them
"""
