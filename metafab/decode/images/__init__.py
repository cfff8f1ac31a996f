"""All-in-focus images, contrast, and the composed Image4D."""
