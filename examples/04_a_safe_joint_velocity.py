"""Drives the hand at the table at 0.3 m/s: what is asked for, and what the safety QP lets pass."""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from feasigrasp.models.control import SafetyFilter, SafetyOptions
from feasigrasp.models.robot import ParallelGripper, pose_and_jacobian

picture = Path(sys.argv[1] if len(sys.argv) > 1 else "out/examples/04_a_safe_joint_velocity.png")

safety = SafetyFilter(SafetyOptions(period=0.005, clearance=0.01, table_height=0.0))
X_FG = ParallelGripper().X_FG
V_WG = np.array([0.0, 0.0, 0.0, 0.0, 0.0, -0.3])  # [angular; linear]

q, qd = np.deg2rad([0, 20, 0, -100, 0, 60, 0]), np.zeros(7)
times, heights, asked, sent = [], [], [], []
for k in range(500):
    X_WG, J_WG = pose_and_jacobian(q, X_FG)
    times.append(0.005 * k)
    heights.append(X_WG[2, 3])
    asked.append(np.linalg.pinv(J_WG) @ V_WG)
    # Closest to the twist within position, velocity and acceleration limits, clear of the table.
    qd = safety.velocity(q, np.zeros(7), J_WG, V_WG, qd_last=qd)
    sent.append(qd)
    q = q + 0.005 * qd
lowest = min(heights) - ParallelGripper().tip
print(f"the finger tips stopped {1e3 * lowest:.0f} mm above the table")
print(
    f"largest joint speed asked for {np.abs(asked).max():.2f}, sent {np.abs(sent).max():.2f} rad/s"
)

figure, axes = plt.subplots(1, 2, figsize=(10, 3.6))
axes[0].plot(times, heights, label="pad centre")
axes[0].plot(times, np.array(heights) - ParallelGripper().tip, label="finger tips")
axes[0].axhline(0.0, color="0.5", lw=4, label="table")
axes[0].set_ylabel("height [m]")
axes[1].plot(times, asked, "--", lw=0.7)
axes[1].set_prop_cycle(None)
axes[1].plot(times, sent)
axes[1].set_ylabel("joint velocity [rad/s]: asked (--), sent")
axes[0].legend()
for ax in axes:
    ax.set_xlabel("time [s]")
figure.tight_layout()
picture.parent.mkdir(parents=True, exist_ok=True)
figure.savefig(picture, dpi=90)
print(f"wrote {picture}")
