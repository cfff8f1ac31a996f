"""To be written: the table of contents of this room."""
