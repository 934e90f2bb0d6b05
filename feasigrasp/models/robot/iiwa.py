"""Data of the KUKA LBR iiwa 7 R800: dimensions, limits, capsules."""

from collections.abc import Iterator
from itertools import product

import numpy as np

from feasigrasp.models.robot.arm import Arm, Capsule, DriverLimits, Family

#: Limits of joint positions [deg] and velocities [rad/s]. Source: data sheet: KUKA LBR iiwa 7 R800.
_POSITION_DEG = np.array([170, 120, 170, 120, 170, 120, 175])
_VELOCITY = np.deg2rad([98, 98, 100, 130, 140, 180, 180])

#: Pairs of bodies of the default hand that can come close inside the joint limits. Left out are
#: neighbours, links 5 and 7 (both turn about the wrist, whose limit stops them before they touch),
#: and every pair whose visible bodies never come nearer than 2 cm; a test searches for the minima.
_PAIRS: tuple[tuple[int, int], ...] = (
    *product((0,), range(4, 12)),
    *product((1,), range(7, 12)),
    *product((2,), (8, 9, 10)),
)

_Segment = tuple[tuple[float, float, float], tuple[float, float, float], float]
#: Links 1 and 2, tube and drum: ends and radius [m]. Links 3 and 4 are the same mirrored.
_UPPER: tuple[_Segment, ...] = (
    ((0.0, 0.0, 0.031), (0.0, 0.0, 0.186), 0.074),
    ((0.0, -0.010, 0.129), (0.0, -0.057, 0.189), 0.076),
)
_LOWER: tuple[_Segment, ...] = (
    ((0.0, 0.0, -0.001), (0.0, 0.0, 0.193), 0.072),
    ((0.0, 0.059, 0.0), (0.0, 0.008, 0.077), 0.075),
)


def _along(body: int, *segments: _Segment) -> Iterator[Capsule]:
    return (Capsule(body, *segment) for segment in segments)


def _mirrored(segment: _Segment) -> _Segment:
    """The segment on the other side of the plane y = 0."""
    (ax, ay, az), (bx, by, bz), radius = segment
    return (ax, -ay, az), (bx, -by, bz), radius


#: The capsules of base and links, which ``python tools/fit_capsules.py`` prints.
_CAPSULES: tuple[Capsule, ...] = (
    *_along(0, ((0.0, 0.0, 0.026), (0.0, 0.0, 0.031), 0.130)),
    *_along(0, ((0.023, 0.0, 0.059), (0.0, 0.0, 0.092), 0.093)),
    *_along(1, *_UPPER),
    *_along(2, *_LOWER),
    *_along(3, *map(_mirrored, _UPPER)),
    *_along(4, *map(_mirrored, _LOWER)),
    *_along(5, ((0.0, 0.0, 0.035), (0.0, 0.0, 0.058), 0.074)),
    *_along(5, ((0.0, -0.004, 0.043), (0.0, -0.077, 0.189), 0.056)),
    *_along(6, ((0.0, -0.012, 0.0), (0.0, 0.003, 0.039), 0.069)),
    *_along(6, ((0.0, 0.036, 0.0), (0.0, 0.011, 0.023), 0.071)),
    *_along(7, ((0.0, 0.0, 0.014), (0.0, 0.0, 0.024), 0.050)),  # holds the hand's adapter too
)

#: Gains of the joints' PD controllers, from the base to the flange [Nm/rad], [Nm s/rad]. The second
#: are 1500 /s times a joint's largest inertia, 600 /s at the wrist, whose torques would come near
#: their limits: the arm follows a commanded velocity within 2 ms, like the drives of a real one,
#: and its acceleration exceeds the commanded one by no more than `Arm.acceleration_share` leaves.
#: Source: reasoned.
_KP = np.array([6000.0, 6000.0, 3000.0, 3000.0, 800.0, 500.0, 300.0])
_KD = np.array([9500.0, 13400.0, 6200.0, 4100.0, 860.0, 860.0, 830.0])

#: KUKA LBR iiwa 7 R800. Heights and limits are those of KUKA's data sheet (0.34 / 0.40 / 0.40 /
#: 0.126 m; 98 ... 180 deg/s); accelerations, which KUKA does not publish, are the estimates used
#: by Drake's own model. The driver keeps 1 degree off the joint limits. The share of the
#: accelerations is 1 over the largest gain of the simulated controller, 1.06, see
#: ``tests/systems/station/test_arm_tracking.py``.
IIWA_7 = Arm(
    name="iiwa",
    points=np.outer([0.15, 0.34, 0.55, 0.74, 0.95, 1.14, 1.221], [0.0, 0.0, 1.0]),
    axes=np.array([[0, 0, 1], [0, 1, 0], [0, 0, 1], [0, -1, 0], [0, 0, 1], [0, 1, 0], [0, 0, 1.0]]),
    X_WF=np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1.266], [0, 0, 0, 1.0]]),
    lower=-np.deg2rad(_POSITION_DEG),
    upper=np.deg2rad(_POSITION_DEG),
    velocity_limits=_VELOCITY,
    acceleration_limits=np.array([8.65, 5.44, 5.69, 11.01, 11.78, 13.76, 13.17]),
    effort_limits=np.array([176.0, 176.0, 110.0, 110.0, 110.0, 40.0, 40.0]),
    driver=DriverLimits(
        lower=-np.deg2rad(_POSITION_DEG - 1),
        upper=np.deg2rad(_POSITION_DEG - 1),
        velocity=_VELOCITY,
        external_torque=60.0 * np.array([1.0, 1.0, 1.0, 0.5, 0.2, 0.2, 0.1]),
    ),
    acceleration_share=0.94,
    position_margin=0.03,
    capsules=_CAPSULES,
    pairs=_PAIRS,
    family=Family.SRS,
    inertias=np.zeros((0, 10)),  # its URDF is packaged
    rotor_inertias=np.zeros(7),
    kp=_KP,
    kd=_KD,
    home=np.deg2rad([0.0, -48.5, 0.0, -90.6, 0.0, 82.9, 0.0]),
)
