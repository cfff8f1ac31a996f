"""Registration: the y image is brought onto the pixel grid of the x image.

- ``twins``         TwinGrid (place of each pixel's twin), Twins (both images on one grid): RawFrame -> Twins
- ``pedestal``      light of a frame that forms no image
- ``resample``      windowed-sinc interpolation of an image at the places of a smooth map
- ``downsampling``  every few pixels of an image, low-pass filtered, and back to all pixels
- ``calibration``   the PSF pair on that grid, at any tile and depth
- ``tiles``         a window cut into overlapping tiles, and put together again
"""
