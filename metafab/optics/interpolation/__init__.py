"""PSFs between the nodes of a stack in depth and field."""
