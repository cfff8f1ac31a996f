"""PSFs between the nodes of a stack.

- ``stacks``  interpolation in depth and direction; join stacks and select depths
- ``basis``   PsfBasis: a stack over depth and field as a few images with smooth weights
"""
