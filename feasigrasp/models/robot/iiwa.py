"""Data of the iiwa 7: dimensions, limits, masses.

Compiled code may name `IIWA_7` directly (``IIWA_7.position_limits[i]``): numba takes a module's
named tuples for constants, and drops from the machine code what is not used of them.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.errors import ArgumentError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.quantities import JOINTS, Whole


class DriverLimits(NamedTuple):
    """Limits of the real arm's driver; without effect in simulation.

    Attributes:
        position: Joint positions are clamped to -position ... position [rad], one per joint.
        velocity: Joint velocities likewise [rad/s].
        external_torque: The arm stops where the external torque of a joint exceeds this [Nm].
    """

    position: Array
    velocity: Array
    external_torque: Array


class Arm(NamedTuple):
    """A serial arm, every link frame aligned with the base frame and on its z-axis at ``q = 0``.

    A joint is then described by its height and its axis. The arrays are read-only and have one
    entry per joint. Kinematics and inverse kinematics are written for arms of the iiwa's build:
    seven joints about z, +y, z, -y, z, +y, z, with shoulder, elbow and wrist on the z-axis.

    Attributes:
        name: Model instance in Drake, and first part of the names of joints and links.
        joints: How many.
        joint_heights: Above the base frame at q = 0 [m].
        flange_height: Likewise [m].
        joint_axes: In the base frame at q = 0, shape (n, 3).
        position_limits: Symmetric: -position_limits <= q <= position_limits [rad].
        velocity_limits: Symmetric [rad/s].
        acceleration_limits: Symmetric [rad/s^2].
        effort_limits: Symmetric [Nm].
        driver: Limits of the real arm's driver.
        acceleration_share: What is commanded uses at most this share of the acceleration limits;
            the rest is the overshoot of the arm's position controller.
        position_margin: What is commanded keeps this far inside the position limits [rad], farther
            than the driver clamps; a configuration nearer to them is none that the arm may take.
    """

    name: str
    joints: int
    joint_heights: Array
    flange_height: float
    joint_axes: Array
    position_limits: Array
    velocity_limits: Array
    acceleration_limits: Array
    effort_limits: Array
    driver: DriverLimits
    acceleration_share: float
    position_margin: float

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names in the model files, from the base on."""
        return tuple(f"{self.name}_joint_{i + 1}" for i in range(self.joints))

    @property
    def link_names(self) -> tuple[str, ...]:
        """Names in the model files, from the base, link 0, on; one more than joints."""
        return tuple(f"{self.name}_link_{i}" for i in range(self.joints + 1))

    @property
    def link_steps(self) -> tuple[float, ...]:
        """From the frame of each link, the base included, to the next, the flange last [m]."""
        return tuple(np.diff([0.0, *self.joint_heights, self.flange_height]).tolist())

    @checked()
    def positions(self, q: Annotated[ArrayLike, JOINTS], ndim: Whole | None = None) -> Array:
        """Joint positions as compiled code takes them, a contiguous array of shape (..., joints).

        Raises:
            ArgumentError: The last axis has another length, there are not ``ndim`` axes, or a joint
                turns by more than 2 pi (degrees?).
        """
        Q = np.asarray(q)
        if ndim not in (None, Q.ndim):
            form = f"({self.joints},)" if ndim == 1 else f"(n, {self.joints})"
            raise ArgumentError(f"q has shape {Q.shape}; give shape {form} for ndim = {ndim}")
        return Q

    @checked()
    def random_positions(self, rng: np.random.Generator, n: Whole) -> Array:
        """Joint positions uniform inside the limits, shape (n, joints) [rad]."""
        return rng.uniform(-self.position_limits, self.position_limits, (n, self.joints))

    @property
    def lengths(self) -> tuple[float, float, float, float]:
        """Distances base-shoulder, shoulder-elbow, elbow-wrist and wrist-flange [m].

        The shoulder is at joint 2, the elbow at joint 4, the wrist at joint 6.
        """
        shoulder, elbow, wrist = self.joint_heights[1:6:2].tolist()
        heights = [0.0, shoulder, elbow, wrist, self.flange_height]
        a, b, c, d = (round(high - low, 9) for low, high in zip(heights, heights[1:], strict=False))
        return a, b, c, d


def _constant(values: ArrayLike) -> Array:
    array = np.array(values, dtype=float)
    array.flags.writeable = False
    return array


#: Limits of joint positions [deg] and velocities [rad/s]. Source: data sheet: KUKA LBR iiwa 7 R800.
_POSITION_DEG = np.array([170, 120, 170, 120, 170, 120, 175])
_VELOCITY = _constant(np.deg2rad([98, 98, 100, 130, 140, 180, 180]))

#: KUKA LBR iiwa 7 R800. Heights and limits are those of KUKA's data sheet (0.34 / 0.40 / 0.40 /
#: 0.126 m; 98 ... 180 deg/s); accelerations, which KUKA does not publish, are the estimates used
#: by Drake's own model. The driver keeps 1 degree off the joint limits. The share of the
#: accelerations is 1 over the largest gain of the simulated controller, 1.06, see
#: ``tests/systems/station/test_arm_tracking.py``.
IIWA_7 = Arm(
    name="iiwa",
    joints=7,
    joint_heights=_constant([0.15, 0.34, 0.55, 0.74, 0.95, 1.14, 1.221]),
    flange_height=1.266,
    joint_axes=_constant(
        [[0, 0, 1], [0, 1, 0], [0, 0, 1], [0, -1, 0], [0, 0, 1], [0, 1, 0], [0, 0, 1]]
    ),
    position_limits=_constant(np.deg2rad(_POSITION_DEG)),
    velocity_limits=_VELOCITY,
    acceleration_limits=_constant([8.65, 5.44, 5.69, 11.01, 11.78, 13.76, 13.17]),
    effort_limits=_constant([176, 176, 110, 110, 110, 40, 40]),
    driver=DriverLimits(
        position=_constant(np.deg2rad(_POSITION_DEG - 1)),
        velocity=_VELOCITY,
        external_torque=_constant(60.0 * np.array([1.0, 1.0, 1.0, 0.5, 0.2, 0.2, 0.1])),
    ),
    acceleration_share=0.94,
    position_margin=0.03,
)
