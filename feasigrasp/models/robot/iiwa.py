"""Facts of the KUKA LBR iiwa 7 R800: kinematics and limits.

Every link frame is axis-aligned with the base frame at ``q = 0`` and lies on the base z-axis, so
a joint is fully described by its height and its axis. Heights and limits are those of KUKA's data
sheet (0.34 / 0.40 / 0.40 / 0.126 m; 98 ... 180 deg/s); accelerations, which KUKA does not publish,
are the estimates used by Drake's own model.
"""

import numpy as np

NUM_JOINTS = 7

#: Height of joint i above the base frame at q = 0 [m].
JOINT_HEIGHTS = np.array([0.15, 0.34, 0.55, 0.74, 0.95, 1.14, 1.221])
FLANGE_HEIGHT = 1.266
#: Axis of joint i in the base frame at q = 0: z, +y, z, -y, z, +y, z.
JOINT_AXES = np.array(
    [[0, 0, 1], [0, 1, 0], [0, 0, 1], [0, -1, 0], [0, 0, 1], [0, 1, 0], [0, 0, 1]], dtype=float
)

#: Distances base-shoulder, shoulder-elbow, elbow-wrist, wrist-flange [m].
D_BASE_SHOULDER, D_SHOULDER_ELBOW, D_ELBOW_WRIST, D_WRIST_FLANGE = 0.34, 0.40, 0.40, 0.126

_POSITION_DEG = np.array([170, 120, 170, 120, 170, 120, 175], dtype=float)
#: Joint limits are symmetric: -POSITION_LIMITS <= q <= POSITION_LIMITS [rad].
POSITION_LIMITS = np.deg2rad(_POSITION_DEG)
VELOCITY_LIMITS = np.deg2rad(np.array([98, 98, 100, 130, 140, 180, 180], dtype=float))
ACCELERATION_LIMITS = np.array([8.65, 5.44, 5.69, 11.01, 11.78, 13.76, 13.17])
EFFORT_LIMITS = np.array([176, 176, 110, 110, 110, 40, 40], dtype=float)
