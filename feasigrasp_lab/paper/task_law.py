"""The paper's task-space law (section IV-D.1): gradient ascent of a mixture's log density.

As printed, ``qd = J^+ grad log p``, with the right Jacobian where it belongs
(`RiemannianMixture.log_density_gradient`). Corrected, the hand follows the direction preconditioned
so that every component is approached along its geodesic, about grasps in place of means, while it
is carried along with the object's twist: without that feed-forward it lags behind by speed over
gain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feasigrasp.errors import ControlError
from feasigrasp.models.arguments import check_fields
from feasigrasp.models.arrays import Array
from feasigrasp.models.choices import parse_choice
from feasigrasp.models.compiled import compiled
from feasigrasp.models.control.task.grasp_mixture import GraspMixture
from feasigrasp.models.control.task.safe_law import hand_twist_kernel
from feasigrasp.models.geometry.se3_kernels import compose_kernel, inverse_kernel
from feasigrasp.models.quantities import NotNegative, Positive
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import pose_jacobian_kernel
from feasigrasp_lab.paper.ascent import ascent_kernel, gradient_kernel
from feasigrasp_lab.paper.options import Law, Targets

#: Least damping: no singular value is taken for smaller.
_LEAST_DAMPING = 1e-6
#: Least pivot of the factorisation, in case rounding eats up even that.
_LEAST_PIVOT = 1e-14


@dataclass(frozen=True)
class PaperTaskOptions:
    """Gains of the law.

    Attributes:
        law: Which velocity leads up the density.
        gain: Rate at which the hand closes its distance to a grasp [1/s]; of the law ``gradient``
            the velocity per gradient, which is in 1/rad and 1/m.
        damping: Of the pseudo-inverse; it matters where singular values of the Jacobian are not far
            above it.
        feed_forward: Whether the object's twist is added.
        targets: What the density is made of: components about their medoids, or their means.
    """

    law: str = Law.PRECONDITIONED
    gain: Positive = 5.0
    damping: NotNegative = 0.02
    feed_forward: bool = True
    targets: str = Targets.MEDOIDS

    def __post_init__(self) -> None:
        """Checks the values.

        Raises:
            ControlError: There is no such law or target, or a number is out of range.
        """
        check_fields(self, ControlError)
        parse_choice(Law, self.law, "law", ControlError)
        parse_choice(Targets, self.targets, "targets", ControlError)


@compiled
def least_norm_kernel(J: Array, V: Array, damping: float) -> Array:
    """The velocity (7,) that minimises ``|J qd - V|^2 + d^2 |qd|^2``, at most ``|V| / (2 d)`` long.

    It is ``J^T (J J^T + d^2 I)^-1 V``, by Cholesky factorisation; without damping the shortest one,
    large where J loses rank, but finite.
    """
    square = max(damping, _LEAST_DAMPING) ** 2
    L, y, qd = np.empty((6, 6)), np.empty(6), np.zeros(IIWA_7.joints)
    for i in range(6):
        for j in range(i + 1):
            s = square if i == j else 0.0
            for k in range(IIWA_7.joints):
                s += J[i, k] * J[j, k]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            L[i, j] = np.sqrt(max(s, _LEAST_PIVOT)) if i == j else s / L[j, j]
    for i in range(6):
        s = V[i]
        for k in range(i):
            s -= L[i, k] * y[k]
        y[i] = s / L[i, i]
    for i in range(5, -1, -1):
        s = y[i]
        for k in range(i + 1, 6):
            s -= L[k, i] * y[k]
        y[i] = s / L[i, i]
    for i in range(6):
        for k in range(IIWA_7.joints):
            qd[k] += J[i, k] * y[i]
    return qd


@compiled
def _paper_kernel(q, X_FG, X_WO, V_WO, parameters, gain, gradient, damping):
    X_WH, J_WH, u_H = np.empty((4, 4)), np.empty((6, IIWA_7.joints)), np.empty(6)
    pose_jacobian_kernel(q, X_FG, X_WH, J_WH)
    X_OH = compose_kernel(inverse_kernel(X_WO), X_WH)
    if gradient:
        gradient_kernel(X_OH, parameters, u_H)
    else:
        ascent_kernel(X_OH, parameters, u_H)
    V_WH = hand_twist_kernel(gain * u_H, X_WH, X_WO, V_WO, np.inf, np.inf)
    qd = least_norm_kernel(J_WH, V_WH, damping)
    return qd if np.isfinite(np.sum(qd)) else np.zeros(IIWA_7.joints)


def paper_task_space_velocity(
    q: Array,
    grasps: GraspMixture,
    X_WO: Array,
    V_WO: Array,
    X_FG: Array,
    options: PaperTaskOptions,
) -> Array:
    """The paper's law, printed or corrected as the options say: ``qd = J^+ V``, nothing enforced.

    The twist V is ``gain`` times the gradient of the log density of the grasps, or the
    preconditioned direction, plus the object's own twist if it is fed forward. Neither is cut
    anywhere. Where the pulls of components cancel, surrounding points decide
    (`feasigrasp_lab.paper.ascent`).

    Args:
        q: Joint positions [rad], shape (7,).
        grasps: Mixture over the grasps, in the object frame.
        X_WO: Object pose, shape (4, 4).
        V_WO: Object twist [angular; linear], shape (6,).
        X_FG: The grasp frame on the flange, shape (4, 4).
        options: Law, gain, damping, feed-forward, targets.

    Returns:
        Joint velocity [rad/s], shape (7,); zero if anything is not finite.
    """
    mixture = grasps.targets if options.targets == Targets.MEDOIDS else grasps.mixture
    qd: Array = _paper_kernel(
        q,
        X_FG,
        X_WO,
        V_WO if options.feed_forward else np.zeros(6),
        mixture.parameters,
        options.gain,
        options.law == Law.GRADIENT,
        options.damping,
    )
    return qd
