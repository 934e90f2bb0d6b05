"""A serial arm as a value: axes, limits, capsules, and the array of them that kernels take.

The frame of every link is parallel to the base frame at ``q = 0``, with its origin on the axis of
the link's joint. A joint is then described by a point and a direction, and the forward kinematics
are a product of turns about known axes (Brockett 1984).
"""

from dataclasses import dataclass, field
from enum import IntEnum
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from feasigrasp.errors import ArgumentError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.quantities import CONFIGURATION, JOINTS, POSE, ArrayOf, Positive, Whole

#: Columns of a joint's row in `Arm.chain`: its axis (0 x, 1 y, 2 z, 3 another) and the sign of it,
#: the way from the link before (3), its limits, the acceleration that may be commanded, the margin
#: of position, a point on the axis (3), and the direction of it (3).
AXIS, SIGN, OFFSET, *_rest = range(24)
LOWER, UPPER, VELOCITY, ACCELERATION, EFFORT, COMMANDED, MARGIN, POINT, *_others = _rest[2:]
#: Column of the direction, and of the first seed behind it. Source: layout.
DIRECTION, SEEDS = POINT + 3, 24
#: Columns of the last row, the flange's: after the way from the last link its rotation (9) and
#: place (3) at q = 0, its `Family`, and the lengths or points that inverse kinematics needs (6).
ROTATION = LOWER
PLACE, FAMILY, GEOMETRY = (ROTATION + k for k in (9, 12, 13))
#: Axes that come this near meet [m]: digits of model files. Source: numerical.
MEETING_TOLERANCE = 1e-5


class Family(IntEnum):
    """Build of an arm, which decides about its inverse kinematics."""

    #: Axes 1 to 3 meet, axes 5 to 7 meet, and axis 4 is at right angles to both neighbours.
    SRS = 0
    #: Axes 1 to 3 meet, and axes 5 and 6.
    SHOULDER_WRIST = 1
    #: Axes 2 to 4 of six are parallel.
    PARALLEL = 2
    #: Any other with six or seven joints: by least squares from the seeds behind its chain.
    SEEDED = 3


def meeting_point(axes: Array, points: Array) -> tuple[Array, float]:
    """The point (3,) [m] nearest to lines by least squares, and the largest distance from it [m].

    The lines have the directions ``axes`` (k, 3), and each a point of ``points`` (k, 3) [m].
    """
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    meeting = np.linalg.lstsq(across.sum(0), np.einsum("kij,kj->i", across, points))[0]
    away = np.einsum("kij,kj->ki", across, meeting - points)
    return meeting, float(np.linalg.norm(away, axis=1).max())


class DriverLimits(NamedTuple):
    """Limits of the real arm's driver; without effect in simulation. One entry per joint.

    Attributes:
        lower: Joint positions are clamped to these ... [rad]
        upper: ... and these [rad].
        velocity: Joint velocities to -velocity ... velocity [rad/s].
        external_torque: The arm stops where the external torque of a joint exceeds this [Nm].
    """

    lower: Array
    upper: Array
    velocity: Array
    external_torque: Array


class Capsule(NamedTuple):
    """A segment from ``a`` to ``b`` with a radius, in the frame of the body's link [m]."""

    body: int
    a: tuple[float, float, float]
    b: tuple[float, float, float]
    radius: float


_VECTOR, _VECTORS = ArrayOf(("n",)), ArrayOf(("n", 3))
_ANGLES = ArrayOf(("n",), "rad", most=CONFIGURATION.most)


@dataclass(frozen=True, eq=False)
class Arm(Frozen):
    """A serial arm of n revolute joints; its arrays are read-only.

    Attributes:
        name: Model instance in Drake, and first part of the names of joints and links.
        points: Origin of each joint's link in the base frame at q = 0, shape (n, 3) [m].
        axes: Joint axes in the base frame at q = 0, unit vectors, shape (n, 3).
        X_WF: Flange frame in the base frame at q = 0, shape (4, 4) [m]. A hand is mounted on it as
            `ParallelGripper.X_FG` says.
        lower: Lower limits of the joint positions, shape (n,) [rad].
        upper: Upper limits, shape (n,) [rad].
        velocity_limits: Symmetric, shape (n,) [rad/s].
        acceleration_limits: Symmetric, shape (n,) [rad/s^2].
        effort_limits: Symmetric, shape (n,) [Nm].
        driver: Limits of the real arm's driver.
        acceleration_share: What is commanded uses at most this share of the acceleration limits;
            the rest is the overshoot of the arm's position controller.
        position_margin: What is commanded keeps this far inside the position limits [rad], farther
            than the driver clamps; a configuration nearer to them is none that the arm may take.
        capsules: Those of the base, body 0, and of the links, in the order of the bodies.
        pairs: Bodies that can come close, see `feasigrasp.models.robot.capsules.body_pairs`.
        family: Its build.
        kp: Gains of the joints' simulated PD controllers, shape (n,) [Nm/rad].
        kd: Likewise, shape (n,) [Nm s/rad].
        inertias: Of base and links, mass [kg], centre of mass [m] and Ixx, Iyy, Izz, Ixy, Ixz, Iyz
            about that [kg m^2] in the frame of each, shape (n + 1, 10).
        rotor_inertias: Of the motors, as the joints feel them, shape (n,) [kg m^2].
        home: A configuration from which the hand looks down in front of the arm, shape (n,) [rad].
        chain: What kernels take, shape (n + 1, 24): a row for each joint and one for the flange;
            columns more hold the seeds of an arm of `Family.SEEDED`.
    """

    name: str
    points: Annotated[Array, _VECTORS]
    axes: Annotated[Array, _VECTORS]
    X_WF: Annotated[Array, POSE]
    lower: Annotated[Array, _ANGLES]
    upper: Annotated[Array, _ANGLES]
    velocity_limits: Annotated[Array, _VECTOR]
    acceleration_limits: Annotated[Array, _VECTOR]
    effort_limits: Annotated[Array, _VECTOR]
    driver: DriverLimits
    acceleration_share: float
    position_margin: float
    capsules: tuple[Capsule, ...]
    pairs: tuple[tuple[int, int], ...]
    family: Family
    inertias: Annotated[Array, ArrayOf(("m", 10))]
    rotor_inertias: Annotated[Array, _VECTOR]
    kp: Annotated[Array, _VECTOR]
    kd: Annotated[Array, _VECTOR]
    home: Annotated[Array, _ANGLES]
    chain: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Checks the arrays, or raises ArgumentError, and lays them out for kernels."""
        check_fields(self)
        arrays = {k: np.array(v) for k, v in vars(self).items() if isinstance(v, np.ndarray)}
        if not np.allclose(np.linalg.norm(self.axes, axis=1), 1.0, rtol=0.0, atol=1e-9):
            raise ArgumentError(f"Arm.axes = {self.axes.tolist()}; give unit vectors")
        sizes = {Family.PARALLEL: (6,), Family.SEEDED: (6, 7)}.get(self.family, (7,))
        if self.joints not in sizes:
            raise ArgumentError(
                f"{self.name} has {self.joints} joints; arms of {' or '.join(map(str, sizes))} are "
                f"supported as {self.family.name.lower()}"
            )
        if self.family == Family.SRS and not np.array_equal(self.lower, -self.upper):
            raise ArgumentError(f"limits of {self.name} are not symmetric; give shoulder_wrist")
        self._freeze(**arrays, chain=self._laid_out())

    def _laid_out(self) -> Array:
        n = self.joints
        chain = np.zeros((n + 1, 24))
        joints, flange = chain[:n], chain[n]
        along = np.abs(self.axes).max(axis=1) == 1.0
        joints[:, AXIS] = np.where(along, np.abs(self.axes).argmax(axis=1), 3.0)
        joints[:, SIGN] = np.where(along, self.axes.sum(axis=1), 1.0)
        joints[:, DIRECTION : DIRECTION + 3] = self.axes
        chain[:, OFFSET:LOWER] = np.diff([np.zeros(3), *self.points, self.X_WF[:3, 3]], axis=0)
        joints[:, LOWER], joints[:, UPPER] = self.lower, self.upper
        joints[:, VELOCITY] = self.velocity_limits
        joints[:, ACCELERATION] = self.acceleration_limits
        joints[:, EFFORT] = self.effort_limits
        joints[:, COMMANDED] = self.acceleration_share * self.acceleration_limits
        joints[:, MARGIN] = self.position_margin
        joints[:, POINT : POINT + 3] = self.points
        flange[ROTATION:PLACE], flange[PLACE:FAMILY] = self.X_WF[:3, :3].ravel(), self.X_WF[:3, 3]
        flange[FAMILY] = self.family
        if self.family == Family.SRS:
            flange[GEOMETRY : GEOMETRY + 4] = self.lengths
        elif self.family == Family.SHOULDER_WRIST:
            flange[GEOMETRY:] = *self._meeting(0, 1, 2), *self._meeting(4, 5)
        elif self.family == Family.PARALLEL:
            flange[GEOMETRY : GEOMETRY + 3] = self._meeting(4, 5)
        else:
            return np.ascontiguousarray(np.hstack([chain, self._seeds()]))
        return chain

    def _seeds(self) -> Array:
        """Random configurations with their flange poses, shape (n + 1, 2 m).

        The first m columns are features of the poses: place [m], then quaternion (x, y, z, w). The
        others are the joint positions [rad], uniform in `turns`.
        """
        m, n, points, X_WF = 4000, self.joints, self.points.copy(), self.X_WF.copy()
        Q = np.random.default_rng(0).uniform(*self.turns, (m, n))
        R, p = Rotation.identity(m), np.zeros((m, 3))
        for angle, axis, point in zip(Q.T, self.axes, points, strict=True):
            turn = Rotation.from_rotvec(angle[:, None] * axis)
            p, R = p + R.apply(point - turn.apply(point)), R * turn
        features = np.hstack(
            [p + R.apply(X_WF[:3, 3]), (R * Rotation.from_matrix(X_WF[:3, :3])).as_quat()]
        )
        seeds = np.zeros((n + 1, 2 * m))
        seeds[:7, :m], seeds[:n, m:] = features.T, Q.T
        return seeds

    def _meeting(self, *joints: int) -> Array:
        """The point where axes meet [m]; raises ArgumentError if they do not."""
        meeting, apart = meeting_point(self.axes[[*joints]], self.points[[*joints]])
        if apart > MEETING_TOLERANCE:
            raise ArgumentError(
                f"axes {', '.join(str(j + 1) for j in joints)} of {self.name} miss each other by "
                f"{1e3 * apart:.3g} mm; give another family than {self.family.name}"
            )
        return meeting

    @property
    def turns(self) -> tuple[Array, Array]:
        """The limits, less what is beyond half a turn from their middle, each shape (n,) [rad]."""
        middle = 0.5 * (self.lower + self.upper)
        return np.maximum(self.lower, middle - np.pi), np.minimum(self.upper, middle + np.pi)

    @property
    def joints(self) -> int:
        """How many."""
        return len(self.axes)

    @property
    def upright(self) -> bool:
        """Whether joint 1 turns about the vertical, so that link 1 stays as high as it is."""
        return abs(float(self.axes[0, 2])) == 1.0

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names in the model files, from the base on."""
        return tuple(f"{self.name}_joint_{i + 1}" for i in range(self.joints))

    @property
    def link_names(self) -> tuple[str, ...]:
        """Names in the model files, from the base, link 0, on; one more than joints."""
        return tuple(f"{self.name}_link_{i}" for i in range(self.joints + 1))

    @property
    def X_LF(self) -> Array:
        """The flange frame in the frame of the last link, shape (4, 4) [m]."""
        X_LF = self.X_WF.copy()
        X_LF[:3, 3] = self.chain[-1, OFFSET:LOWER]
        return X_LF

    @checked()
    def positions(self, q: Annotated[ArrayLike, JOINTS], ndim: Whole | None = None) -> Array:
        """Joint positions as compiled code takes them, a contiguous array of shape (..., joints).

        Raises:
            ArgumentError: The last axis has another length, there are not ``ndim`` axes, or a joint
                is more than 2.5 turns from zero (degrees?).
        """
        Q = np.asarray(q)
        if ndim not in (None, Q.ndim) or Q.shape[-1:] != (self.joints,):
            leading = {1: "", 2: "n, "}.get(ndim or 0, "..., ")
            form = f"({leading}{self.joints}{'' if leading else ','})"
            raise ArgumentError(f"q has shape {Q.shape}; give shape {form}")
        return Q

    @checked()
    def random_positions(self, rng: np.random.Generator, n: Whole) -> Array:
        """Joint positions uniform inside the limits, shape (n, joints) [rad]."""
        return rng.uniform(self.lower, self.upper, (n, self.joints))

    @checked()
    def braking_rate(self, speed: Positive, acceleration_share: Positive) -> float:
        """Acceleration over velocity of the joint that takes longest to stop [1/s].

        Of both limits the joints have these shares: they are so fast, and brake so hard.
        """
        brakes = acceleration_share * self.acceleration_limits
        return float(np.min(brakes / (speed * self.velocity_limits)))

    @property
    def link_steps(self) -> tuple[float, ...]:
        """Heights at q = 0 from each link, the base included, to the next, the flange last [m]."""
        return tuple(self.chain[:, OFFSET + 2].tolist())

    @property
    def reach(self) -> float:
        """From joint 2 to the flange, along the longest edges of the ways between links [m]."""
        return float(np.abs(self.chain[2:, OFFSET:LOWER]).max(axis=1).sum())

    @property
    def lengths(self) -> tuple[float, float, float, float]:
        """Of an S-R-S arm: base-shoulder, shoulder-elbow, elbow-wrist and wrist-flange [m].

        The shoulder is at joint 2, the elbow at joint 4, the wrist at joint 6.
        """
        shoulder, elbow, wrist = self.points[1:6:2, 2].tolist()
        heights = [0.0, shoulder, elbow, wrist, float(self.X_WF[2, 3])]
        a, b, c, d = (round(high - low, 9) for low, high in zip(heights, heights[1:], strict=False))
        return a, b, c, d
