"""Raw frames in memory and in files."""
