"""Joint-space control over inverse kinematics solutions of many grasps (paper section IV-D.2).

The arm descends the distance field over the solutions, ``qd = -k d grad d``, while the solutions
move with the object. Added to the paper's law: each solution's own velocity is fed forward, so that
the arm does not lag; solutions keep their identity, so that the field moves smoothly; the field has
at every solution the value of what it will cost to be there; the solutions follow the approach
corridor into their grasps; and a QP keeps limits and clearances, which the field alone does not.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from feasigrasp.errors import ControlError
from feasigrasp.models.arguments import check_fields
from feasigrasp.models.arrays import Array
from feasigrasp.models.choices import parse_choice
from feasigrasp.models.compiled import compiled
from feasigrasp.models.control.horizon.distance_field import (
    NOISE_VARIANCE,
    distances_kernel,
    evaluate_kernel,
    fit_kernel,
)
from feasigrasp.models.control.joint.options import SolutionOptions
from feasigrasp.models.control.joint.search import SolutionSearch
from feasigrasp.models.control.joint.solutions import Solutions, feed_forward_kernel, place_kernel
from feasigrasp.models.control.planning.clearance_schedule import (
    retreat_velocity,
    scheduled_obstacle,
)
from feasigrasp.models.control.planning.cost_weights import CostWeights
from feasigrasp.models.objects.predicted_poses import PredictionModel, predicted_poses
from feasigrasp.models.control.safety.safe_velocity import SafetyFilter, SafetyOptions
from feasigrasp.models.geometry.obstacle_grid import ObstacleGrid
from feasigrasp.models.geometry.se3_kernels import inverse_kernel
from feasigrasp.models.grasps.approach_corridor import ApproachCorridor
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.objects.prediction import Motion
from feasigrasp.models.quantities import Bound, Positive
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import pose_jacobian_kernel


@dataclass(frozen=True)
class JointControlOptions:
    """Gains of the joint-space controller.

    Attributes:
        gain: Rate k at which the way that is left decreases, within the speed limits and so that it
            can be stopped in time [1/s].
        max_speed: Largest share of the velocity limits used for it.
        feed_forward: Whether the solutions' own velocity is added; not in the paper.
        solutions: Which solutions the field is fitted to.
        costs: What they cost, and how far is looked ahead.
        prediction: What the object is taken to do meanwhile, a `PredictionModel`.
        corridor: The way into a grasp.
        safety: Margins of the QP.
    """

    gain: Positive = 8.0
    max_speed: Bound = 0.8
    feed_forward: bool = True
    solutions: SolutionOptions = field(default_factory=SolutionOptions)
    costs: CostWeights = field(default_factory=CostWeights.for_joint_field)
    prediction: str = PredictionModel.PREDICTED
    corridor: ApproachCorridor = field(
        default_factory=lambda: ApproachCorridor(closing_axis_share=0.3)
    )
    safety: SafetyOptions = field(default_factory=SafetyOptions)

    def __post_init__(self) -> None:
        """Checks the values.

        Raises:
            ControlError: There is no such look-ahead, or a number is out of range.
        """
        check_fields(self, ControlError)
        parse_choice(PredictionModel, self.prediction, "prediction", ControlError)


@compiled
def _descent_kernel(left, gradient, gain, max_speed, qd):
    """Writes ``-k d grad d`` (7,), within the speed limits and so that it can be stopped in time.

    Half of the acceleration limits is taken to suffice for the way left along every joint.
    """
    slope = 0.0
    for k in range(IIWA_7.joints):
        slope += gradient[k] ** 2
    slope = np.sqrt(slope)
    if not left > 0.0 or slope < 1e-12:
        qd[:] = 0.0
        return
    speed = gain * left
    for k in range(IIWA_7.joints):
        part = max(abs(gradient[k]) / slope, 1e-9)
        speed = min(speed, max_speed * IIWA_7.velocity_limits[k] / part)
        speed = min(speed, np.sqrt(IIWA_7.acceleration_limits[k] * left / part))
    for k in range(IIWA_7.joints):
        qd[k] = -speed * min(1.0, slope) * gradient[k] / slope


@compiled(forceinline=True)
def field_kernel(
    q,
    X_FG,
    X_WO,
    V_WO,
    elapsed,
    X_OG,
    branch,
    arm_angle,
    cost,
    length_scale,
    corridor,
    most,
    gradient,
    forward,
):
    """Distance d of the field at q and remaining distance: inverse kinematics and fit.

    Writes the gradient (7,), and the mean velocity (7,) of the solutions, shortened to ``most``
    times the joints' velocity limits; all are zero without solutions.
    """
    n = len(branch)
    X_WH, J = np.empty((4, 4)), np.empty((6, IIWA_7.joints))
    pose_jacobian_kernel(q, X_FG, X_WH, J)
    X_OH = inverse_kernel(X_WO) @ X_WH
    X_GF = inverse_kernel(X_FG)
    angles = np.empty((n, 2))
    for i in range(n):
        rate, acceleration = arm_angle[i, 1], arm_angle[i, 2]
        angles[i, 0] = arm_angle[i, 0] + elapsed * (rate + 0.5 * elapsed * acceleration)
        angles[i, 1] = rate + elapsed * acceleration
    X_WF, q_i, index = (
        np.empty((n, 4, 4)),
        np.empty((n, IIWA_7.joints)),
        np.empty(n, dtype=np.int64),
    )
    count = place_kernel(X_WO, X_OH, X_OG, branch, angles, corridor, X_GF, X_WF, q_i, index)
    gradient[:] = 0.0
    forward[:] = 0.0
    if count == 0:
        return 0.0, 0.0
    q_i, index = q_i[:count], index[:count]
    costs, lowest, beta = np.empty(count), np.empty(count), np.empty(count)
    for k in range(count):
        costs[k] = cost[index[k], 0] + elapsed * cost[index[k], 1]
    scale = length_scale[0] + elapsed * length_scale[1]
    r, weights = np.empty((count, count)), np.empty(count)
    distances_kernel(q_i, r)
    fit_kernel(r, costs, scale, NOISE_VARIANCE, lowest, beta)
    d, left = evaluate_kernel(q, q_i, lowest, beta, scale, gradient, weights)
    feed_forward_kernel(
        *(X_WF, V_WO, X_WO[:3, 3].copy(), branch, angles, index, weights, q_i),
        *(most, forward),
    )
    return d, left


@compiled
def field_velocity_kernel(
    q, X_FG, X_WO, V_WO, elapsed, X_OG, branch, arm_angle, cost, length_scale, corridor, gains
):
    """Joint velocity (7,) of the field: down its gradient, and along with the solutions."""
    gain, max_speed, feed_forward = gains
    gradient, forward = np.empty(IIWA_7.joints), np.empty(IIWA_7.joints)
    _, left = field_kernel(
        *(q, X_FG, X_WO, V_WO, elapsed, X_OG, branch, arm_angle, cost, length_scale, corridor),
        *(1.0, gradient, forward),
    )
    qd = np.empty(IIWA_7.joints)
    _descent_kernel(left, gradient, gain, max_speed, qd)
    if feed_forward:
        qd += forward
    return qd


@dataclass(frozen=True, eq=False)
class JointSpaceControl:
    """The joint-space controller.

    Attributes:
        reachability: Limits, clearances, and the hand.
        options: Gains.
        period: Time between updates of the solutions [s].
    """

    reachability: Reachability
    options: JointControlOptions = field(default_factory=JointControlOptions)
    period: float = 0.05
    search: SolutionSearch = field(init=False, repr=False)
    safety: SafetyFilter = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Derives what every step needs."""
        options, gripper = self.options, self.reachability.gripper
        search = SolutionSearch(
            self.reachability, options.corridor, options.costs, options.solutions, self.period
        )
        object.__setattr__(self, "search", search)
        object.__setattr__(self, "safety", SafetyFilter(options.safety, gripper))

    def update(
        self,
        previous: Solutions,
        time: float,
        grasps: GraspSet,
        X_WO: Array,
        V_WO: Array,
        q: Array,
        motion: Motion | None = None,
    ) -> Solutions:
        """The solutions that are followed for the next period.

        Args:
            previous: Those until now.
            time: Now [s].
            grasps: Grasps on offer now, in the object frame.
            X_WO: Object pose, shape (4, 4).
            V_WO: Object twist [angular; linear], shape (6,).
            q: Joint positions [rad], shape (7,).
            motion: Predicts the object's poses; without it they follow its twist.

        Returns:
            The solutions; those until now if the object's pose or twist is not finite.
        """
        if not np.isfinite(X_WO.sum() + V_WO.sum() + q.sum()):
            return previous
        times = self.options.costs.instants
        predicted = predicted_poses(self.options.prediction, motion, X_WO, V_WO, times)
        q = np.ascontiguousarray(q, dtype=float)
        return self.search.update(previous, time, grasps, predicted, q)

    def requested_velocity(
        self, q: Array, solutions: Solutions, time: float, X_WO: Array, V_WO: Array
    ) -> Array:
        """Field velocity without limits; arguments as `velocity`, shape (7,) [rad/s].

        Zero without solutions, or if anything is not finite.
        """
        if len(solutions) == 0 or not np.isfinite(q.sum() + X_WO.sum() + V_WO.sum()):
            return np.zeros(IIWA_7.joints)
        options = self.options
        qd = field_velocity_kernel(
            np.ascontiguousarray(q, dtype=float),
            self.reachability.gripper.X_FG,
            np.ascontiguousarray(X_WO, dtype=float),
            np.ascontiguousarray(V_WO, dtype=float),
            min(max(time - solutions.time, 0.0), self.period),
            solutions.X_OG,
            solutions.branch,
            solutions.arm_angle,
            solutions.cost,
            solutions.length_scale,
            options.corridor.parameters,
            (options.gain, options.max_speed, options.feed_forward),
        )
        return np.asarray(qd)

    def velocity(
        self,
        q: Array,
        solutions: Solutions,
        time: float,
        X_WO: Array,
        V_WO: Array,
        qd_last: Array | None = None,
        obstacles: ObstacleGrid | None = None,
        surface: ObstacleGrid | None = None,
    ) -> Array:
        """The command.

        Args:
            q: Joint positions [rad], shape (7,).
            solutions: Those of the last update.
            time: Now [s].
            X_WO: Object pose, shape (4, 4).
            V_WO: Object twist [angular; linear], shape (6,).
            qd_last: The command of one control period ago [rad/s], shape (7,); if it is not given,
                accelerations are not limited.
            obstacles: What else the arm keeps clear of.
            surface: Distances to the object's surface, in its frame, which the open hand keeps off.

        Returns:
            Joint velocity [rad/s], shape (7,). Without solutions, or if the object's pose or twist
            is not finite, the arm stops, within its acceleration limits.
        """
        qd = self.requested_velocity(q, solutions, time, X_WO, V_WO)
        X_FG, corridor = self.reachability.gripper.X_FG, self.options.corridor
        moving = scheduled_obstacle(surface, q, X_WO, V_WO, X_FG, solutions.X_OG, corridor)
        if moving is not None and moving.misaligned:
            return retreat_velocity(
                self.safety, q, X_FG, moving, qd_last=qd_last, obstacles=obstacles
            )
        return self.safety.velocity(q, qd, qd_last=qd_last, obstacles=obstacles, moving=moving)
