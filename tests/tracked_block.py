"""An object that looks different from everywhere, for tests that track it."""

import numpy as np
import trimesh

from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.raycasting import Raycaster

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
