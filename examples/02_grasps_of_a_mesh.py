"""Grasps of a drill, and why the other candidates were dropped."""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from feasigrasp.models.grasps import perceive
from feasigrasp.models.objects import load_object

picture = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples/02_grasps_of_a_mesh.png")

# Points from all round, so no camera; any closed mesh will do: load_object("part.stl", scale=1e-3).
mesh = load_object("drill").mesh
perceived = perceive(mesh.sample(5000, seed=0), viewpoint=None, sampler="network")
grasps, hand = perceived.grasps, perceived.gripper
print(f"{len(grasps)} grasps, {1e3 * grasps.width.min():.0f} to {1e3 * grasps.width.max():.0f} mm")
for reason, count in grasps.rejected.items():
    print(f"  {count:5d} dropped: {reason}")

# The open hand as a line in the grasp frame G: x closes, z approaches.
x, tip, heel = hand.max_opening / 2, hand.tip, hand.heel
line = [[0, heel - 0.05], [0, heel], [-x, heel], [-x, tip], [-x, heel], [x, heel], [x, tip]]
p_GH = np.insert(np.array(line), 1, 0.0, axis=1)

figure = plt.figure(figsize=(10, 4.5))
ax = figure.add_subplot(1, 2, 1, projection="3d")
ax.plot_trisurf(*mesh.vertices.T, triangles=mesh.faces, color="0.8", alpha=0.6)
for X_OG in grasps.X_OG:
    ax.plot(*(X_OG[:3, :3] @ p_GH.T + X_OG[:3, 3:]), "C2", lw=1)
ax.set_aspect("equal")
ax.set_axis_off()
ax = figure.add_subplot(1, 2, 2)
ax.barh(["kept", *grasps.rejected], [len(grasps), *grasps.rejected.values()], color="C0")
ax.invert_yaxis()
ax.set_xlabel("candidates")
figure.tight_layout()
picture.parent.mkdir(parents=True, exist_ok=True)
figure.savefig(picture, dpi=90)
print(f"wrote {picture}")
