"""Numerics that several rooms share."""
