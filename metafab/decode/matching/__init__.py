"""Cost volume of the twin images over candidate depths."""
