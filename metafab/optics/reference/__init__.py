"""Slow, exact references for the fast propagation."""
