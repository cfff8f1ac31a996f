"""OASIS (SEMI P39): reader and writer."""
