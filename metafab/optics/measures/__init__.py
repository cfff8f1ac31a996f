"""Figures of merit of a PSF stack and of a written mask."""
