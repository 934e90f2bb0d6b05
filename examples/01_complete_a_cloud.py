"""Completes the shape of a bottle from what a camera saw of it: from one side, then from two."""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import trimesh

from feasigrasp.models.clouds import FusedCloud
from feasigrasp.models.objects import load_object
from feasigrasp.models.shape import complete_shape

picture = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples/01_complete_a_cloud.png")
figure, axes = plt.subplots(1, 2, figsize=(9, 3.8))

# Points all over the bottle, in the object's frame O, and cameras that see the sides facing them.
# Your own clouds are read with `feasigrasp.models.clouds.read_cloud`.
mesh = load_object("mustard_bottle").mesh
points, faces = mesh.sample(20_000, return_index=True, seed=0)
normals = mesh.face_normals[faces]
cameras = {"one view": [0.3, -0.35, 0.2], "two views": [-0.4, 0.1, 0.2]}

x, y = np.meshgrid(np.linspace(-0.07, 0.07, 81), np.linspace(-0.07, 0.07, 81))
slice_ = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])  # at the height of O
cloud = FusedCloud.empty(voxel_size=0.003, smooth=True)
for k, (name, p_OC) in enumerate(cameras.items()):
    visible = np.sum((p_OC - points) * normals, axis=1) > 0
    cloud = cloud.merged(points[visible], p_OC)
    field = complete_shape(cloud)
    # The field can be asked anywhere, so ask it how far off the points of the true surface are.
    error = 1e3 * np.abs(field.refine(points)[0])
    print(f"{name}: {len(cloud.points)} points, {len(field.completion)} on the completed surface;")
    print(f"  error {np.median(error):.1f} mm (median), {np.quantile(error, 0.95):.1f} mm (95 %)")
    distance = 1e3 * field.distance(slice_).reshape(x.shape)
    axes[0].contour(x, y, distance, levels=[0.0], colors=f"C{k}")
    axes[0].plot([], f"C{k}", label=f"completed from {name}")

outline = trimesh.intersections.mesh_plane(mesh, [0.0, 0.0, 1.0], [0.0, 0.0, 0.0])
axes[0].plot(*outline[..., :2].T, "k", lw=1)
axes[0].plot([], "k", label="true outline")
axes[0].legend(fontsize=8)
shown = axes[1].contourf(x, y, field.variance(slice_).reshape(x.shape), levels=20)
figure.colorbar(shown, ax=axes[1], label="variance: 0 where it was seen")
axes[1].contour(x, y, distance, levels=np.arange(-20, 60, 10), colors="w", linewidths=0.7)
for ax in axes:
    ax.set_aspect("equal")
    ax.set_xlabel("x [m]")
    ax.set_xticks([-0.05, 0.0, 0.05])
figure.tight_layout()
picture.parent.mkdir(parents=True, exist_ok=True)
figure.savefig(picture, dpi=90)
print(f"wrote {picture}")
