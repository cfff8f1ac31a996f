"""Terms of a target phase."""
