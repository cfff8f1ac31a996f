"""Image points, optical path lengths, and the substrate as a plane-parallel plate."""
