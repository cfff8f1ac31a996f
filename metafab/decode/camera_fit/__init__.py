"""Calibration of a camera from photographs of a point."""
