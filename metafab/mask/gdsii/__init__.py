"""GDSII (Stream format 6): reader and writer."""
