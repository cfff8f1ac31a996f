"""Segments of a frame: connected pixels on one plane."""
