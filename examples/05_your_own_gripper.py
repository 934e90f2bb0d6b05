"""Describes a hand in six lengths and two boxes: which objects can it hold that others cannot?"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from feasigrasp.models.grasps import Rejection, perceive
from feasigrasp.models.objects import load_object
from feasigrasp.models.robot import WSG_50, ParallelGripper

picture = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples/05_your_own_gripper.png")

# Lengths in metres, in the grasp frame G between the pads: x closes, z approaches. Nothing is
# trained anew: sampler, filter, reachability and control read the hand from here.
WIDE = ParallelGripper(
    max_opening=0.14,
    finger_thickness=0.012,
    finger_width=0.020,
    tip=0.020,
    heel=-0.075,
    palm_size=(0.150, 0.060, 0.070),
    tool_offset=0.16,
    camera_center=(0.0, 0.085, -0.130),
)
HANDS = {"default": ParallelGripper(), "WSG 50": WSG_50, "wide": WIDE}
THINNED = (Rejection.NEAR_COPY, Rejection.UNCERTAIN)
OBJECTS = ("screwdriver", "mustard_bottle", "water_bottle", "ball", "bowl")

held = np.zeros((len(HANDS), len(OBJECTS)), dtype=int)
for j, name in enumerate(OBJECTS):
    points = load_object(name).mesh.sample(4000, seed=0)
    for i, hand in enumerate(HANDS.values()):
        grasps = perceive(points, None, gripper=hand, sampler="antipodal").grasps
        # Those that hold and are clear of the object; then the best few were chosen from them.
        held[i, j] = len(grasps) + sum(grasps.rejected.get(r, 0) for r in THINNED)
for label, row in zip(HANDS, held, strict=True):
    print(f"{label:8s}", ", ".join(f"{n} on {o}" for n, o in zip(row, OBJECTS, strict=True)))

figure, axes = plt.subplots(1, 2, figsize=(10, 3.8), width_ratios=[1, 2])
for k, (name, hand) in enumerate(HANDS.items()):
    p_G = hand.surface_points(hand.max_opening)
    axes[0].plot(1e3 * p_G[:, 0], 1e3 * p_G[:, 2] - 250 * k, ".", ms=4, label=name)
    axes[1].bar(np.arange(len(OBJECTS)) + 0.27 * (k - 1), held[k], width=0.27, label=name)
axes[0].set_aspect("equal")
axes[0].set_title("points of the open hands, from the side [mm]", fontsize=9)
axes[1].set_xticks(range(len(OBJECTS)), OBJECTS)
axes[1].set_ylabel("candidates that hold and do not collide")
axes[1].legend()
figure.tight_layout()
picture.parent.mkdir(parents=True, exist_ok=True)
figure.savefig(picture, dpi=90)
print(f"wrote {picture}")
