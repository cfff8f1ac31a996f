"""A scene rendered layer by layer and blurred."""
