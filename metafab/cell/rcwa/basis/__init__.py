"""Truncated bases of the unit cell: coordinate maps, basis functions, symmetry classes."""
