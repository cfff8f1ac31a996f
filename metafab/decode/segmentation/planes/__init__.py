"""Tilted planes through the cells of a segment or of a whole picture.

A segment is cut into cells, and each cell is given a depth. A plane is fitted where a single depth does not explain
them.

- ``plane``   Plane: vergence that is linear over the picture, or quadratic
- ``cells``   Cells: squares of a segment, each with its depth
- ``robust``  :func:`fit_plane`: least median of squares, Tukey's biweight
- ``ransac``  :func:`ransac_planes`: planes over a whole picture, across its layers
"""

from metafab.decode.segmentation.planes.cells import CELL_PX, Cells, cell_depths, cell_side
from metafab.decode.segmentation.planes.plane import Plane
from metafab.decode.segmentation.planes.ransac import FEWEST_INLIERS, distinct_planes, ransac_planes
from metafab.decode.segmentation.planes.robust import fit_plane

__all__ = [
    "CELL_PX",
    "FEWEST_INLIERS",
    "Cells",
    "Plane",
    "cell_depths",
    "cell_side",
    "distinct_planes",
    "fit_plane",
    "ransac_planes",
]
