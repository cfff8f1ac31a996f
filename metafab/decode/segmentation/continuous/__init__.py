"""Continuous surfaces: the depth of each pixel where no few planes are the scene, as in pictures with their depth.

- ``surface``       cost volume -> Surface: semi-global matching over windows that hold the pixel anywhere
- ``local_planes``  levels of that surface smoothed along the planes through them, up to its outlines
- ``doubt``         probability that a pixel of a surface has the right depth
"""
