"""Cells, references and shapes of a mask file, whatever its format."""
