"""Scene files: what is photographed, in which light, and the noise of the sensor.

- ``rgbd``   Rgbd: picture with its depth, and the checks of its files
- ``scene``  SceneObject: opaque surface; Scene: objects or a picture with its depth, photons, noise
"""

from metafab.spec.scene.rgbd import Rgbd
from metafab.spec.scene.scene import Scene, SceneObject

__all__ = ["Rgbd", "Scene", "SceneObject"]
