"""Blocks of unlike pillars: the joint effect of their rows and columns.

- ``joint``     joint effect in a small block, by coarse spectral elements
- ``lattice``   field of a larger block by chains that are coupled from line to line
- ``cross``     cross-polarised light of a larger block
- ``training``  the couplings, fitted to joint effects of small blocks
"""
