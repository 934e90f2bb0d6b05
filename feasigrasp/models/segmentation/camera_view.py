"""One depth image with normals and pixel neighborhoods."""

from dataclasses import dataclass

from feasigrasp.models.arrays import Array, Floats, Frozen


@dataclass(frozen=True, eq=False)
class CameraView(Frozen):
    """One depth image with derived quantities.

    Attributes:
        points: Points in the world frame W, row by row, not finite where nothing was measured,
            shape (height * width, 3) [m].
        X_WC: Pose of the camera, z forward, x to the right, y down, shape (4, 4).
    """

    points: Floats
    X_WC: Array
