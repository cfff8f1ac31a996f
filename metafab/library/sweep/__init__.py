"""Building a library: adaptive sampling, checkpoints, corners."""
