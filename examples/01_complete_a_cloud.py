"""Completes the shape of a bottle that a camera saw from one side; how good is the guess?"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import open3d as o3d
import trimesh

from feasigrasp.models.clouds import FusedCloud
from feasigrasp.models.objects import load_object
from feasigrasp.models.shape import complete_shape

picture = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples/01_complete_a_cloud.png")

# What a camera at p_OC would see of the bottle, in the object's frame O; your own clouds are read
# with `feasigrasp.models.clouds.read_cloud`.
mesh = load_object("mustard_bottle").mesh
p_OC = np.array([0.3, -0.35, 0.2])
everything = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(mesh.sample(20_000, seed=0)))
_, visible = everything.hidden_point_removal(p_OC, radius=50.0)
points = np.asarray(everything.points)

cloud = FusedCloud.empty(voxel_size=0.003, smooth=True).merged(points[visible], p_OC)
field = complete_shape(cloud)

# The field can be asked anywhere, so ask it how far off the points of the true surface are.
error = 1e3 * np.abs(field.refine(points)[0])
hidden = np.setdiff1d(np.arange(len(points)), visible)
print(f"{len(cloud.points)} points seen, {len(field.completion)} on the completed surface")
print(f"median error {np.median(error[visible]):.1f} mm where it was seen, ", end="")
print(f"{np.median(error[hidden]):.1f} mm behind")

# A horizontal slice: distance, completed and true outline.
x, y = np.meshgrid(np.linspace(-0.08, 0.08, 81), np.linspace(-0.08, 0.08, 81))
slice_ = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
distance = 1e3 * field.distance(slice_).reshape(x.shape)
figure, axes = plt.subplots(1, 2, figsize=(9, 4))
near = np.abs(cloud.points[:, 2]) < 0.01
axes[0].scatter(*cloud.points[near, :2].T, s=8, label="seen")
outline = trimesh.intersections.mesh_plane(mesh, [0.0, 0.0, 1.0], [0.0, 0.0, 0.0])
axes[0].plot(*outline[..., :2].T, "k")
axes[0].plot([], "k", label="true")
axes[0].contour(x, y, distance, levels=[0.0], colors="C1")
axes[0].plot([], "C1", label="completed")
axes[0].legend()
shown = axes[1].contourf(x, y, field.variance(slice_).reshape(x.shape), levels=20)
figure.colorbar(shown, ax=axes[1], label="variance: 0 where it was seen")
axes[1].contour(x, y, distance, levels=np.arange(-20, 60, 10), colors="w", linewidths=0.7)
for ax in axes:
    ax.set_aspect("equal")
    ax.set_xlabel("x [m]")
figure.tight_layout()
picture.parent.mkdir(parents=True, exist_ok=True)
figure.savefig(picture, dpi=90)
print(f"wrote {picture}")
