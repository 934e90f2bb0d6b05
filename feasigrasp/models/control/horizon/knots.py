"""What the kernels of a plan share: its knots, the grasps, and the quadratic form of its cost."""

from typing import NamedTuple

from feasigrasp.models.arrays import Array, Float32, Indices


class Knots(NamedTuple):
    """The plan before, at its N knots, and the object then.

    Attributes:
        chain: That of the `Arm`.
        times: From now on, shape (N,) [s].
        q: Joint positions, shape (N, 7) [rad].
        X_WH: Poses of the hand, shape (N, 4, 4) [m].
        J_WH: Its Jacobians, shape (N, 6, 7).
        X_WO: Poses of the object, shape (N, 4, 4) [m].
        X_WO_after: Those `feasigrasp.models.control.horizon.reference.INSTANT` later.
        share: Share of the standoff that the joint limits leave, shape (N,).
    """

    chain: Array
    times: Array
    q: Array
    X_WH: Array
    J_WH: Array
    X_WO: Array
    X_WO_after: Array
    share: Array


class Neighbours(NamedTuple):
    """The selected grasp and those near it.

    Attributes:
        X_OG: In the object frame, shape (m, 4, 4) [m].
        branch: Inverse-kinematics branches, shape (m,).
        psi: Arm angles, shape (m,) [rad].
        penalty: By how much each costs more than the selected one, shape (m,) [s].
    """

    X_OG: Array
    branch: Indices
    psi: Array
    penalty: Array


class Meeting(NamedTuple):
    """The arm now, and at the interception.

    Attributes:
        q: Joint positions now, shape (7,) [rad].
        v: Joint velocities now, shape (7,) [rad/s].
        left: Time to the interception [s].
        q_there: Joint positions there, shape (7,) [rad].
        v_there: Joint velocities there, shape (7,) [rad/s].
    """

    q: Array
    v: Array
    left: float
    q_there: Array
    v_there: Array


class Surface(NamedTuple):
    """The object's surface, and the hand that keeps off it.

    Attributes:
        hand: Points of the hand, in H, shape (k, 3) [m].
        values: Of an `ObstacleGrid` in O; empty without one.
        frame: Of the grid.
        clearance: Least distance of a hand that is lined up [m].
    """

    hand: Array
    values: Float32
    frame: Array
    clearance: float


class Form(NamedTuple):
    """A quadratic form at every knot, ``1/2 dq' H dq + g' dq``, and the reference's velocity.

    Attributes:
        H: Hessians, shape (N, 7, 7).
        g: Gradients, shape (N, 7).
        v_ref: Joint velocities, shape (N, 7) [rad/s].
    """

    H: Array
    g: Array
    v_ref: Array
