"""Pages and pictures of single results."""
