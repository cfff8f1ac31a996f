"""Using a library: inverse look-up, quality, checks."""
