"""Rendering: a scene at rest -> mean electrons of each pixel.

- ``texture``    brightness patterns
- ``render``     objects -> coverage and brightness at each of their depths
- ``picture``    surfaces of a scene that is given by a picture and its depths
- ``picture_image`` image of these surfaces, with constant radiance at outlines
- ``occlusion``  share of the aperture that sees each point of a surface behind another
- ``motion``     a moving scene -> the scene at one time; rows of the sensor -> their exposures
- ``windows``    rectangles of the sensor on which the two images lie
- ``blur``       convolution of a layer with PSFs that vary over the field
- ``depth_blur`` convolution of a surface whose depth changes from pixel to pixel
- ``lens``       both images of a scene, from far to near
"""
