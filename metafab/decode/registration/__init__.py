"""The two images of a frame brought onto one grid."""
