"""Target pose of the hand: a mean-shift step over the grasps near the selected one.

The grasps near the chosen one, X*, which the arm can hold in the same branch, have weights: of
their score, of the density of all grasps there, and of what each costs the arm from here on
(`feasigrasp.models.control.planning.cost_weights`). They make a density, with a bandwidth s::

    p(x) = sum_i w_i N(Log_X_i(x); 0, s^2),    s = SHARPNESS * error of the hand beside X*

and the target is where the gradient of its logarithm leads from X*, one step of mean shift::

    target = X* exp(sum_i r_i Log_X*(X_i)),    r_i ~ w_i exp(-|Log_X*(X_i)|^2 / (2 s^2))

Far away, all of the neighbourhood counts and the hand goes for its middle, which moves little when
another of its grasps becomes the best. As the hand lines up, the density sharpens, and the target
is X*, a grasp: means of grasps need not be any, and none leads into the object. What is left along
the approach direction does not count as an error: on the way in, the target must not move sideways.
With a single weight the target is X* throughout.
"""

from __future__ import annotations

import numpy as np

from feasigrasp.models.arrays import Array, Indices
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry.se3_kernels import (
    compose_kernel,
    exp_kernel,
    inverse_kernel,
    log_kernel,
)

#: Metres that count as much as one radian in comparing poses. Source: guessed.
LENGTH_PER_RADIAN = 0.1
#: Bandwidth of the density per error of the hand. Source: guessed.
SHARPNESS = 0.15


@compiled
def square_kernel(v):
    """Square of the length of a tangent vector [angular; linear], in metres."""
    angular = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    return LENGTH_PER_RADIAN**2 * angular + v[3] * v[3] + v[4] * v[4] + v[5] * v[5]


@compiled
def steps_kernel(X_OG, others):
    """Tangent vectors (m, 6) that lead from a grasp (4, 4) to others (m, 4, 4)."""
    X_GO, steps = inverse_kernel(X_OG), np.empty((len(others), 6))
    for i in range(len(others)):
        steps[i] = log_kernel(compose_kernel(X_GO, others[i]))
    return steps


@compiled
def target_kernel(X_OG, steps, weights, X_OH):
    """The target (4, 4) of a hand at ``X_OH`` that goes for the grasp ``X_OG``.

    ``steps`` (m, 6) lead to the grasps near it, itself among them, and ``weights`` (m,) are theirs;
    without any the target is the grasp.
    """
    error = log_kernel(compose_kernel(inverse_kernel(X_OG), X_OH))
    error[5] = 0.0
    bandwidth = SHARPNESS**2 * square_kernel(error)
    mean, total = np.zeros(6), 0.0
    for i in range(len(weights)):
        r = weights[i] * np.exp(-0.5 * square_kernel(steps[i]) / max(bandwidth, 1e-12))
        mean += r * steps[i]
        total += r
    return compose_kernel(X_OG, exp_kernel(mean / total)) if total > 0.0 else X_OG.copy()


def neighbours(X_OG: Array, index: int, radius: float) -> tuple[Indices, Array]:
    """The grasps (n, 4, 4) not farther than a radius [m] from one of them, the nearest first.

    Returns:
        Their indices, shape (m,), that of the grasp itself first, and the steps to them, (m, 6).
    """
    steps = steps_kernel(X_OG[index], X_OG)
    square = np.array([square_kernel(v) for v in steps])
    square[index] = -1.0
    order = np.argsort(square, kind="stable")
    near = order[square[order] <= radius**2]
    return near, steps[near]
