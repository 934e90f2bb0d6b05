"""Static bodies of the cell: visual and collision geometry, signed distances.

A body collides as the convex hulls of its connected parts. A hull is the intersection of half
spaces ``n . x + d <= 0``; the largest of these values is the distance to the hull where a face is
nearest, and a lower bound of it beside edges and corners.
"""

from dataclasses import dataclass, field
from typing import Self

import numpy as np
import trimesh
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull, QhullError

from feasigrasp.errors import MeshError
from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.objects.mesh import obj_text

_URDF = """<?xml version="1.0"?>
<robot name="{name}" xmlns:drake="http://drake.mit.edu">
  <link name="{name}">
    <visual>
      <geometry><mesh filename="surface.obj"/></geometry>
      <material name="{name}_color"><color rgba="0.55 0.58 0.62 1"/></material>
    </visual>
{parts}
  </link>
</robot>
"""
#: Contact as with the table (``models/iiwa/table.urdf``).
_COLLISION = """    <collision name="part_{i}">
      <geometry><mesh filename="part_{i}.obj"><drake:declare_convex/></mesh></geometry>
      <drake:proximity_properties>
        <drake:compliant_hydroelastic/>
        <drake:hydroelastic_modulus value="10000000"/>
        <drake:hunt_crossley_dissipation value="20"/>
        <drake:mu_static value="0.8"/>
        <drake:mu_dynamic value="0.8"/>
      </drake:proximity_properties>
    </collision>"""


@dataclass(frozen=True, eq=False)
class StaticObstacle(Frozen):
    """A body that does not move.

    Attributes:
        name: Its name.
        mesh: Its surface, in its own frame B [m].
        X_WB: Its pose, shape (4, 4) [m].
        parts: Convex hulls of its connected parts, in B.
        half_spaces: For each of them rows n, d in the world, unit normals outwards, shape (m, 4).
    """

    name: str
    mesh: trimesh.Trimesh
    X_WB: Array
    parts: tuple[trimesh.Trimesh, ...] = field(init=False)
    half_spaces: tuple[Array, ...] = field(init=False)

    def __post_init__(self) -> None:
        """Finds the convex parts; raises MeshError for a flat one."""
        self._freeze(X_WB=np.array(self.X_WB, dtype=float))
        pieces = self.mesh.split(only_watertight=False)
        R, p = self.X_WB[:3, :3], self.X_WB[:3, 3]
        parts, planes = [], []
        for piece in pieces if len(pieces) else [self.mesh]:
            try:
                hull = ConvexHull(piece.vertices)
            except QhullError as error:
                raise MeshError(
                    f"{self.name} has a part that is flat; an obstacle needs a thickness"
                ) from error
            parts.append(trimesh.Trimesh(piece.vertices, hull.simplices).convex_hull)
            n, d = hull.equations[:, :3] @ R.T, hull.equations[:, 3]
            rows = np.column_stack([n, d - n @ p])
            # Rows that differ by less are the same.
            _, kept = np.unique(np.round(rows / 1e-6), axis=0, return_index=True)
            planes.append(rows[kept])
        object.__setattr__(self, "parts", tuple(parts))
        object.__setattr__(self, "half_spaces", tuple(planes))

    @classmethod
    def box(cls, name: str, size: ArrayLike, X_WB: Array) -> Self:
        """A box with edges of a size (3,) [m] about the origin of B."""
        return cls(name, trimesh.creation.box(np.asarray(size, dtype=float)), X_WB)

    @property
    def bounds(self) -> Array:
        """Lowest and highest corner in the world, shape (2, 3) [m]."""
        corners = self.mesh.vertices @ self.X_WB[:3, :3].T + self.X_WB[:3, 3]
        return np.array([corners.min(axis=0), corners.max(axis=0)])

    def distance(self, x: Array) -> Array:
        """Signed distances of points (..., 3) in the world, shape (...) [m]; see the module."""
        nearest = np.full(x.shape[:-1], np.inf)
        for planes in self.half_spaces:
            outside = np.full(x.shape[:-1], -np.inf)
            for *n, d in planes:
                np.maximum(outside, x @ np.array(n) + d, out=outside)
            np.minimum(nearest, outside, out=nearest)
        return nearest

    def files(self) -> dict[str, str]:
        """The body as files of a URDF model, ``obstacle.urdf``, by their names."""
        files = {f"part_{i}.obj": obj_text(part) for i, part in enumerate(self.parts)}
        collisions = "\n".join(_COLLISION.format(i=i) for i in range(len(self.parts)))
        urdf = _URDF.format(name=self.name, parts=collisions)
        return {"obstacle.urdf": urdf, "surface.obj": obj_text(self.mesh), **files}
