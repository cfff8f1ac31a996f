"""Optimisers of a helix, and bounds on what any optimiser can reach."""
