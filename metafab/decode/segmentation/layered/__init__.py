"""Model of the frame: layers of light, of which nearer ones hide farther ones, fitted to the twins by likelihood.

- ``layer_light``  light of layers in tiles: its blur on the downsampled pixels
- ``layer_tiles``  the layers of a frame in tiles: where each may hold the light, what hides what, noise
- ``tile_shares``  a round of expectation and maximisation: light and shares of the layers in some tiles
- ``frame_model``  FrameModel: outlines from the model
"""
