"""Modes of a layer and what a stack of layers does to an incident wave."""
