"""Decoded images against the truth and against the Cramer-Rao bound."""
