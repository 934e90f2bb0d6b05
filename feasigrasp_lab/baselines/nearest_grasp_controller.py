"""Baseline controller: damped least squares towards the nearest reachable grasp.

Of the grasps that exact inverse kinematics reaches now, the one with the least travel time is
followed, along its approach direction, until another one is nearer by `SAVED`; what the hand leaves
free leads to the configuration that was found. No mixture, no field, no look-ahead.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.control.safety.safe_velocity import SafetyOptions
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.approach_corridor import ApproachCorridor, standoff_kernel
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import pose_and_jacobian
from feasigrasp.scenario.schema import ReachabilityConfig, Scenario
from feasigrasp.systems.grasp_controller import ControllerInputs, GraspController
from feasigrasp_lab.paper.modes import Unenforced
from feasigrasp_lab.paper.options import PaperOptions
from feasigrasp_lab.paper.task_law import hand_twist_kernel, least_norm_kernel

#: Another grasp is followed if it is reached sooner by this [s]. Source: guessed.
SAVED = 0.2
#: Rate at which the hand closes its distance to the grasp [1/s], and the largest speed and angular
#: speed relative to the object [m/s], [rad/s]. Source: guessed.
GAIN, MAX_LINEAR, MAX_ANGULAR = 5.0, 0.4, 1.5
#: The approach corridor.
_CORRIDOR = ApproachCorridor()


@dataclass(frozen=True, eq=False)
class NearestGrasp(Frozen):
    """The grasp that is followed; not finite without one.

    Attributes:
        X_OG: Its pose in O, shape (4, 4) [m].
        q: The nearest configuration that holds it [rad], shape (7,).
    """

    X_OG: Array = field(default_factory=lambda: np.full((4, 4), np.nan))
    q: Array = field(default_factory=lambda: np.full(IIWA_7.joints, np.nan))

    def __post_init__(self) -> None:
        """Makes the arrays read-only."""
        self._freeze(X_OG=np.array(self.X_OG, dtype=float), q=np.array(self.q, dtype=float))

    def __bool__(self) -> bool:
        """Whether there is one."""
        return bool(np.isfinite(self.X_OG[0, 0]))


def nearest_grasp(
    before: NearestGrasp, q: Array, X_OG: Array, X_WO: Array, reachability: Reachability
) -> NearestGrasp:
    """The grasp to follow.

    Args:
        before: The one that was followed; kept while it is there, in reach, and not much farther.
        q: Joint positions [rad], shape (7,).
        X_OG: Grasps, shape (n, 4, 4).
        X_WO: Object pose, shape (4, 4).
        reachability: Test and distance of grasps.
    """
    if len(X_OG) == 0 or not np.isfinite(X_WO).all():
        return NearestGrasp()
    found, times = reachability.nearest(X_WO @ X_OG, q)
    best = int(np.argmin(times))
    if not np.isfinite(times[best]):
        return NearestGrasp()
    # Poses are the same grasp if no entry differs by more.
    same = np.flatnonzero(np.abs(X_OG - before.X_OG).max(axis=(1, 2)) < 1e-9)
    if len(same) and times[same[0]] < times[best] + SAVED:
        best = int(same[0])
    return NearestGrasp(X_OG[best], found[best])


def nearest_grasp_velocity(
    q: Array,
    grasp: NearestGrasp,
    X_WO: Array,
    V_WO: Array,
    reachability: Reachability,
    options: PaperOptions,
) -> Array:
    """Joint velocity (7,) [rad/s] of the damped pseudo-inverse towards a grasp, nothing enforced.

    Arguments as of `paper_task_space_velocity`. It is zero without a grasp in reach, or if anything
    is not finite.
    """
    known = np.isfinite(X_WO).all() and np.isfinite(V_WO).all()
    if not (grasp and known and reachability.reachable(X_WO @ grasp.X_OG)[0]):
        return np.zeros(IIWA_7.joints)
    X_WH, J_WH = pose_and_jacobian(q, reachability.gripper.X_FG)
    X_OH = se3.inverse(X_WO) @ X_WH
    X_OT = grasp.X_OG.copy()
    X_OT[:3, 3] -= standoff_kernel(X_OT, X_OH, _CORRIDOR.parameters) * X_OT[:3, 2]
    gain = float(options.gain) or GAIN
    u_H = -gain * se3.log(se3.inverse(X_OT) @ X_OH)
    V_O = np.array(V_WO if options.feed_forward else np.zeros(6), dtype=float)
    limits = MAX_ANGULAR, MAX_LINEAR
    V_WH = hand_twist_kernel(u_H, X_WH, np.ascontiguousarray(X_WO, dtype=float), V_O, *limits)
    J = np.ascontiguousarray(J_WH)
    fastest = IIWA_7.velocity_limits
    to_solution = np.clip(gain * (grasp.q - q), -fastest, fastest)
    qd: Array = to_solution + least_norm_kernel(J, V_WH - J @ to_solution, float(options.damping))
    return qd if np.isfinite(qd).all() else np.zeros(len(qd))


def make_controller(
    scenario: Scenario, reachability: Reachability, safety: SafetyOptions
) -> NearestGraspController:
    """The controller ``nearest`` of a scenario."""
    options = PaperOptions.of(scenario)
    make = NearestGraspController if scenario.control.safe else _Unenforced
    return make(reachability, options, safety=safety, period=scenario.reachability.period)


class NearestGraspController(GraspController):
    """Follows the grasp that exact inverse kinematics says is nearest, and nothing else.

    At every update the grasp with the least travel time is chosen; the memory is a `NearestGrasp`.
    In between a damped pseudo-inverse leads the hand there, with the object's twist fed forward,
    and in ``safe`` mode the QP keeps limits and clearances.
    """

    def __init__(
        self,
        reachability: Reachability,
        options: PaperOptions | None = None,
        *,
        safety: SafetyOptions | None = None,
        period: float = ReachabilityConfig.period,
    ) -> None:
        """A controller; arguments as of `GraspController`, and the gains of the law."""
        super().__init__(reachability, NearestGrasp(), safety=safety, period=period)
        self._options = options or PaperOptions()
        self.warm_up()

    def update(self, memory: NearestGrasp, inputs: ControllerInputs) -> NearestGrasp:
        """The grasp to follow."""
        X_OG = inputs.grasps.X_OG
        return nearest_grasp(memory, inputs.q, X_OG, inputs.X_WO, self.reachability)

    def chosen(self, memory: NearestGrasp) -> Array | None:
        """The grasp that is followed."""
        return memory.X_OG if memory else None

    def velocity(self, memory: NearestGrasp, inputs: ControllerInputs) -> Array:
        """Towards the grasp."""
        qd = nearest_grasp_velocity(
            inputs.q, memory, inputs.X_WO, inputs.V_WO, self.reachability, self._options
        )
        return self.enforced(qd, inputs)


class _Unenforced(Unenforced, NearestGraspController):
    """The same with nothing enforced."""
