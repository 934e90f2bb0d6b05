"""An object that looks different from everywhere, for tests that track it."""

import numpy as np
import trimesh

from feasigrasp.models.geometry import se3
from feasigrasp_lab.training.data.raycasting import Raycaster

#: Without symmetry: a block with a nose.
MESH = trimesh.util.concatenate(
    [
        trimesh.creation.box((0.06, 0.08, 0.12)),
        trimesh.creation.box(
            (0.03, 0.05, 0.03), transform=se3.make_pose(np.eye(3), [0.0, 0.05, 0.03])
        ),
    ]
)
SURFACE = Raycaster(MESH.vertices, MESH.faces)


def surface_error(X_WO, X_true):
    """Mean distance of the surface at one pose from that at another [m]."""
    E = se3.inverse(X_true) @ X_WO
    points = MESH.vertices
    return SURFACE.distance(points @ E[:3, :3].T + E[:3, 3]).mean()


def on_a_circle(t, speed, radius=0.12, X_start=None):
    """Pose and velocity of an object that goes round the place of a pose, the origin if None."""
    X = np.eye(4) if X_start is None else X_start.copy()
    angle = speed / radius * t
    X[:3, 3] += radius * np.array([0.0, np.cos(angle), np.sin(angle)])
    return X, speed * np.array([0.0, -np.sin(angle), np.cos(angle)])
