"""Where the hand can point down at a table, and why it cannot elsewhere."""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity

import feasigrasp as fg
from feasigrasp.models.reach import VERDICTS, Reachability

picture = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples/03_what_the_arm_can_reach.png")

# Hand poses X_WG over a vertical plane through the arm's base, the approach direction z_G down.
x, z = np.meshgrid(np.linspace(-1.0, 1.0, 201), np.linspace(0.0, 1.3, 131))
X_WG = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (x.size, 1, 1))
X_WG[:, 0, 3], X_WG[:, 2, 3] = x.ravel(), z.ravel()

# Exact: closed-form inverse kinematics, joint limits, self-collision, table.
reachability = Reachability()
verdicts = reachability.verdicts(X_WG)
REASONS = VERDICTS[:5]  # the others are those of grasps
for code, reason in enumerate(REASONS):
    print(f"{np.mean(verdicts == code):6.1%} {reason}")

# Where there is one, the configuration that is soonest reached from q.
q = np.deg2rad([0, -48.5, 0, -90.6, 0, 82.9, 0])
nearest, seconds = reachability.nearest(X_WG, q)
print(f"from q: {np.median(seconds[np.isfinite(seconds)]):.2f} s (median) at full speed")

# As a system: verdicts on the grasps of any sampler, of an object that moves.
system = fg.FeasiblePoses(reachability)
context = system.CreateDefaultContext()
some = X_WG[::100]
for port, value in {
    "grasps": fg.GraspSet(some, np.full(len(some), 0.05), np.ones(len(some))),
    "object_pose": RigidTransform(),
    "object_velocity": SpatialVelocity([0.0, 0.0, 0.0], [0.0, 0.1, 0.0]),
    "position": q,
}.items():
    system.GetInputPort(port).FixValue(context, value)
found = system.get_output_port().Eval(context)
print(f"{found.verdicts.count('reachable')} of {len(some)} can be met; one: {found.later[0]} later")

figure, axes = plt.subplots(1, 2, figsize=(11, 4), sharey=True)
image = {"origin": "lower", "extent": (-1.0, 1.0, 0.0, 1.3)}
colors = plt.get_cmap("tab10", len(REASONS))
shown = axes[0].imshow(verdicts.reshape(x.shape), cmap=colors, vmin=-0.5, vmax=4.5, **image)
bar = figure.colorbar(shown, ax=axes[0], ticks=range(len(REASONS)))
bar.ax.set_yticklabels(REASONS)
axes[0].set_title("exact verdict")
shown = axes[1].imshow(np.where(np.isfinite(seconds), seconds, np.nan).reshape(x.shape), **image)
figure.colorbar(shown, ax=axes[1], label="seconds at full speed")
axes[1].set_title("time from q")
for ax in axes:
    ax.set_xlabel("x [m]")
axes[0].set_ylabel("z [m]")
figure.tight_layout()
picture.parent.mkdir(parents=True, exist_ok=True)
figure.savefig(picture, dpi=90)
print(f"wrote {picture}")
