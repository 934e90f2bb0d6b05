"""The paper's joint-space law (section IV-D.2): descent of the distance field over IK solutions.

As printed, ``qd = -k d grad d`` with solutions that are drawn anew at every update. Corrected, the
way that is left decreases at the rate k, the solutions' own velocity is fed forward, and the
solutions keep their identity. All solutions are worth the same, and nothing is enforced.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from feasigrasp.errors import ControlError
from feasigrasp.models.arguments import check_fields
from feasigrasp.models.arrays import Array, Indices
from feasigrasp.models.choices import parse_choice
from feasigrasp.models.compiled import compiled
from feasigrasp.models.control.joint.law import JointControlOptions, field_kernel
from feasigrasp.models.control.joint.options import SolutionOptions
from feasigrasp.models.control.joint.search import SolutionSearch
from feasigrasp.models.control.joint.solutions import Solutions
from feasigrasp.models.ik.continuation import branch_kernel
from feasigrasp.models.control.planning.cost_weights import CostWeights
from feasigrasp.models.objects.predicted_poses import PredictionModel, predicted_poses
from feasigrasp.models.grasps.approach_corridor import ApproachCorridor
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.ik.self_motion import arm_angle_kernel
from feasigrasp.models.objects.prediction import Motion
from feasigrasp.models.quantities import NotNegative, Positive
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp_lab.paper.options import Law
from feasigrasp_lab.paper.sources import Draw

#: Straight to the grasps.
_CORRIDOR: ApproachCorridor = JointControlOptions().corridor._replace(max_standoff=0.0)
#: No plan: nothing but the present counts. Source: definition.
_COSTS = CostWeights(times=(0.0,))


def _resampled(draw: Draw, n: int, X_WF: Array) -> tuple[Array, Indices]:
    """Configurations of flange poses, as many of each, from the same random numbers at every call.

    Args:
        draw: Where they come from.
        n: How many are drawn; those that miss their pose are left out.
        X_WF: Flange poses, shape (m, 4, 4); m > 0.

    Returns:
        Configurations (k, 7) [rad], and which pose each reaches, shape (k,).
    """
    drawn = draw(X_WF, -(-n // len(X_WF)))
    # The first of every pose, then the second, up to the number that is wanted.
    found = drawn.swapaxes(0, 1).reshape(-1, IIWA_7.joints)[:n]
    reached = np.isfinite(found).all(axis=1)
    return found[reached], (np.arange(len(found)) % len(X_WF))[reached]


def _still(q: Array, X_OG: Array, length_scale: float, time: float) -> Solutions:
    """Solutions that cost nothing and whose arm angles stay.

    Args:
        q: Their configurations, shape (k, 7) [rad].
        X_OG: Their grasps in the object frame, shape (k, 4, 4).
        length_scale: Of the field [rad].
        time: Now [s].
    """
    still = np.zeros((len(q), 2))
    return Solutions(
        X_OG,
        np.array([branch_kernel(one) for one in q], dtype=np.int64),
        np.column_stack([[arm_angle_kernel(one) for one in q], still]),
        still,
        np.array([length_scale, 0.0]),
        time,
    )


@dataclass(frozen=True)
class PaperJointOptions:
    """Gains of the law.

    Attributes:
        law: ``preconditioned``: the way that is left decreases at the rate k; ``gradient``: as
            printed.
        gain: k [1/s].
        feed_forward: Whether the solutions' own velocity is added; not in the paper.
        length_scale: Of the field [rad]; 0 follows the spacing of the solutions.
        solutions: Which solutions the field is fitted to.
        draw: What they are drawn from anew at every update, as in the paper; None to keep their
            identity.
    """

    law: str = Law.PRECONDITIONED
    gain: Positive = 8.0
    feed_forward: bool = True
    length_scale: NotNegative = 0.0
    solutions: SolutionOptions = field(default_factory=lambda: SolutionOptions(glide=0.0))
    draw: Draw | None = None

    def __post_init__(self) -> None:
        """Checks the values.

        Raises:
            ControlError: There is no such law, or a number is out of range.
        """
        check_fields(self, ControlError)
        parse_choice(Law, self.law, "law", ControlError)


@compiled
def _velocity_kernel(
    q, X_FG, X_WO, V_WO, elapsed, X_OG, branch, arm_angle, cost, length_scale, corridor, law
):
    as_printed, gain, feed_forward = law
    gradient, forward = np.empty(IIWA_7.joints), np.empty(IIWA_7.joints)
    d, left = field_kernel(
        *(q, X_FG, X_WO, V_WO, elapsed, X_OG, branch, arm_angle, cost, length_scale, corridor),
        *(np.inf, gradient, forward),
    )
    qd = np.zeros(IIWA_7.joints)
    if as_printed:
        qd[:] = -gain * d * gradient
    else:
        slope = 0.0
        for k in range(IIWA_7.joints):
            slope += gradient[k] ** 2
        slope = np.sqrt(slope)
        if left > 0.0 and slope >= 1e-12:
            for k in range(IIWA_7.joints):
                qd[k] = -(gain * left) * min(1.0, slope) * gradient[k] / slope
    if feed_forward:
        qd += forward
    return qd


@dataclass(frozen=True, eq=False)
class _Search(SolutionSearch):
    """Solutions that keep their identity, in a field of a given length scale."""

    given: float = 0.0

    def length_scale(self, q: Array) -> float:
        """The given one [rad], or that of the spacing if it is 0."""
        return self.given or super().length_scale(q)


class PaperJointControl:
    """The paper's joint-space controller, printed or corrected as the options say.

    Args:
        reachability: Limits, clearances, and the hand.
        options: Gains.
        period: Time between updates of the solutions [s].
    """

    def __init__(
        self, reachability: Reachability, options: PaperJointOptions, period: float
    ) -> None:
        self._reachability, self._options, self._period = reachability, options, period
        self._search = _Search(
            *(reachability, _CORRIDOR, _COSTS, options.solutions, period), options.length_scale
        )

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
        """The solutions for the next period, as `JointSpaceControl.update`."""
        if not np.isfinite(X_WO.sum() + V_WO.sum() + q.sum()):
            return previous
        ahead = predicted_poses(PredictionModel.PREDICTED, motion, X_WO, V_WO, _COSTS.instants)
        q, draw, X_OG = np.ascontiguousarray(q, dtype=float), self._options.draw, grasps.X_OG
        if draw is None:
            return self._search.update(previous, time, grasps, ahead, q)
        if len(X_OG) == 0:
            return Solutions.empty(time)
        X_WF = self._search.flange_poses(X_OG, ahead[0], q)
        found, grasp = _resampled(draw, self._options.solutions.n_solutions, X_WF)
        return _still(found, X_OG[grasp], self._search.length_scale(found), time)

    def velocity(
        self, q: Array, solutions: Solutions, time: float, X_WO: Array, V_WO: Array
    ) -> Array:
        """The command [rad/s], shape (7,); zero without solutions or if anything is not finite.

        Args:
            q: Joint positions [rad], shape (7,).
            solutions: Those of the last update.
            time: Now [s].
            X_WO: Object pose, shape (4, 4).
            V_WO: Object twist [angular; linear], shape (6,).
        """
        if len(solutions) == 0 or not np.isfinite(q.sum() + X_WO.sum() + V_WO.sum()):
            return np.zeros(IIWA_7.joints)
        options = self._options
        qd = _velocity_kernel(
            np.ascontiguousarray(q, dtype=float),
            self._reachability.gripper.X_FG,
            np.ascontiguousarray(X_WO, dtype=float),
            np.ascontiguousarray(V_WO, dtype=float),
            min(max(time - solutions.time, 0.0), self._period),
            solutions.X_OG,
            solutions.branch,
            solutions.arm_angle,
            solutions.cost,
            solutions.length_scale,
            _CORRIDOR.parameters,
            (options.law == Law.GRADIENT, options.gain, options.feed_forward),
        )
        return np.asarray(qd)
