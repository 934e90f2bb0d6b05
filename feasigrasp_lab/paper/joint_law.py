"""The paper's joint-space law (section IV-D.2): descent of the distance field over IK solutions.

As printed, ``qd = -k d grad d`` with solutions that are drawn anew at every update. Corrected, the
way that is left decreases at the rate k, the solutions' own velocity is fed forward, and the
solutions keep their identity. All solutions are worth the same, and nothing is enforced.
"""

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.control.horizon.distance import (
    NOISE_VARIANCE,
    distances_kernel,
    evaluate_kernel,
    fit_kernel,
)
from feasigrasp.models.geometry.se3_kernels import inverse_kernel
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.ik.continuation import branch_kernel, solve_kernel
from feasigrasp.models.ik.self_motion import arm_angle_kernel
from feasigrasp.models.objects.prediction import Motion, future_poses
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.arm import VELOCITY
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp_lab.paper.options import Law, PaperOptions
from feasigrasp_lab.paper.solutions import Solutions, SolutionSearch, place_kernel
from feasigrasp_lab.paper.sources import from_flow

_CHAIN, _N = IIWA_7.chain, IIWA_7.joints

#: Gains of the law ``preconditioned``, and of the ``gradient`` [1/s]. Source: guessed.
GAINS = (8.0, 1.0)
#: Time over which a velocity is taken [s]; its error is of the order of the squared angle that the
#: object turns meanwhile. Source: numerical.
_INSTANT = 1e-5
#: Solutions that count less than this are not fed forward. Source: numerical.
_NEGLIGIBLE = 1e-4


@compiled
def candidate_velocity_kernel(X_WF, V_WO, p_WO, branch, psi, q, moved, qd):
    """Writes the velocity (7,) of a candidate at a flange pose; ``moved`` (4, 4) is scratch.

    The closed form's derivative along the twist at a fixed arm angle: the inverse of the Jacobian
    with the arm angle for a seventh row. False next to where it has none.
    """
    wx, wy, wz = V_WO[0], V_WO[1], V_WO[2]
    for j in range(4):
        x, y, z = X_WF[0, j], X_WF[1, j], X_WF[2, j]
        if j == 3:
            x, y, z = x - p_WO[0], y - p_WO[1], z - p_WO[2]
        moved[0, j] = X_WF[0, j] + _INSTANT * (wy * z - wz * y)
        moved[1, j] = X_WF[1, j] + _INSTANT * (wz * x - wx * z)
        moved[2, j] = X_WF[2, j] + _INSTANT * (wx * y - wy * x)
    for i in range(3):
        moved[i, 3] += _INSTANT * V_WO[3 + i]
    if not solve_kernel(_CHAIN, moved, branch, psi, qd):
        return False
    for k in range(len(q)):
        qd[k] = (qd[k] - q[k]) / _INSTANT
        if not abs(qd[k]) < 100.0 * _CHAIN[k, VELOCITY]:
            return False
    return True


@compiled
def feed_forward_kernel(X_WF, V_WO, p_WO, branch, arm_angle, index, weights, q, qd):
    """Writes the mean velocity (7,) of the solutions that count."""
    moved, one = np.empty((4, 4)), np.empty(_N)
    moved[3] = 0.0
    moved[3, 3] = 1.0
    qd[:] = 0.0
    for k in range(len(index)):
        if weights[k] > _NEGLIGIBLE:
            i = index[k]
            if candidate_velocity_kernel(
                X_WF[k], V_WO, p_WO, branch[i], arm_angle[i], q[k], moved, one
            ):
                for j in range(_N):
                    qd[j] += weights[k] * one[j]


@compiled
def _velocity_kernel(q, X_FG, X_WO, V_WO, X_OG, branch, arm_angle, cost, length_scale, law):
    """Joint velocity (7,) of the field over the solutions; zero without one in reach."""
    (as_printed, gain, feed_forward), n = law, len(branch)
    qd, index = np.zeros(_N), np.empty(n, dtype=np.int64)
    X_WF, nodes = np.empty((n, 4, 4)), np.empty((n, _N))
    count = place_kernel(X_WO, X_OG, branch, arm_angle, inverse_kernel(X_FG), X_WF, nodes, index)
    if count == 0:
        return qd
    nodes, index = nodes[:count], index[:count]
    gradient, forward = np.empty(_N), np.empty(_N)
    lowest, beta = np.empty(count), np.empty(count)
    r, weights = np.empty((count, count)), np.empty(count)
    distances_kernel(nodes, r)
    fit_kernel(r, cost[index], length_scale, NOISE_VARIANCE, lowest, beta)
    d, left = evaluate_kernel(q, nodes, lowest, beta, length_scale, gradient, weights)
    if as_printed:
        qd[:] = -gain * d * gradient
    else:
        slope = 0.0
        for k in range(_N):
            slope += gradient[k] ** 2
        slope = np.sqrt(slope)
        if left > 0.0 and slope >= 1e-12:
            for k in range(_N):
                qd[k] = -(gain * left) * min(1.0, slope) * gradient[k] / slope
    if feed_forward:
        p_WO = X_WO[:3, 3].copy()
        feed_forward_kernel(X_WF, V_WO, p_WO, branch, arm_angle, index, weights, nodes, forward)
        qd += forward
    return qd


class PaperJointControl:
    """The paper's joint-space controller, printed or corrected as the options say.

    Args:
        reachability: Limits, clearances, and the hand.
        options: Gains.
        period: Time between updates of the solutions [s].
    """

    def __init__(self, reachability: Reachability, options: PaperOptions, period: float) -> None:
        self._reachability, self._options, self._period = reachability, options, period
        self._search = SolutionSearch(reachability, options, period)

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
        """The solutions for the next period; the previous ones if anything is not finite.

        Args:
            previous: Those until now.
            time: Now [s].
            grasps: Grasps on offer, in the object frame.
            X_WO: Object pose, shape (4, 4).
            V_WO: Object twist [angular; linear], shape (6,).
            q: Joint positions [rad], shape (7,).
            motion: What is known of the object's motion.
        """
        if not np.isfinite(X_WO.sum() + V_WO.sum() + q.sum()):
            return previous
        (X_WO,), q = future_poses(motion, X_WO, V_WO, 0.0), np.ascontiguousarray(q, dtype=float)
        X_OG = grasps.X_OG
        if not self._options.resample:
            return self._search.update(previous, time, X_OG, X_WO, q)
        if len(X_OG) == 0:
            return Solutions.empty(time)
        return self._drawn(X_OG, X_WO, time)

    def _drawn(self, X_OG: Array, X_WO: Array, time: float) -> Solutions:
        """As many draws of each grasp (m, 4, 4), from the same random numbers at every call."""
        X_WF, n = self._search.flange_poses(X_OG, X_WO), self._options.n_solutions
        # The first of every pose, then the second, up to the number that is wanted.
        found = from_flow(X_WF, -(-n // len(X_WF))).swapaxes(0, 1).reshape(-1, _N)[:n]
        reached = np.isfinite(found).all(axis=1)
        grasp, q = (np.arange(len(found)) % len(X_WF))[reached], found[reached]
        return Solutions(
            X_OG[grasp],
            np.array([branch_kernel(_CHAIN, one) for one in q], dtype=np.int64),
            np.array([arm_angle_kernel(_CHAIN, one) for one in q]),
            np.zeros((len(q), 2)),
            np.array([self._search.length_scale(q), 0.0]),
            time,
        )

    def velocity(
        self, q: Array, solutions: Solutions, time: float, X_WO: Array, V_WO: Array
    ) -> Array:
        """The command [rad/s], shape (7,); zero without solutions or if anything is not finite.

        Arguments as of `update`.
        """
        if len(solutions) == 0 or not np.isfinite(q.sum() + X_WO.sum() + V_WO.sum()):
            return np.zeros(_N)
        options = self._options
        elapsed = min(max(time - solutions.time, 0.0), self._period)
        qd = _velocity_kernel(
            np.ascontiguousarray(q, dtype=float),
            self._reachability.gripper.X_FG,
            np.ascontiguousarray(X_WO, dtype=float),
            np.ascontiguousarray(V_WO, dtype=float),
            *(solutions.X_OG, solutions.branch, solutions.arm_angle, *solutions.at(elapsed)),
            (options.law == Law.GRADIENT, options.gain_or(*GAINS), options.feed_forward),
        )
        return np.asarray(qd)
