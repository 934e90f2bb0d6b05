"""Inverse kinematics of any arm by damped least squares from seeds.

The step is ``J^T (J J^T + lambda I)^-1 e`` (Wampler 1986; Nakamura and Hanafusa 1986), with lambda
in proportion to ``|e|^2`` (Sugihara, "Solvability-unconcerned inverse kinematics by the
Levenberg-Marquardt method", T-RO 2011), clamped to the limits. Seeds are the configurations of
an `Arm`'s chain whose flange poses are nearest to the one that is wanted. A
*branch* is a seed, and the last of seven joints is the redundancy: both are kept along an object
path, and so is the solution, as long as it moves smoothly.
"""

import math

import numpy as np

from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry.se3_kernels import quaternion_kernel
from feasigrasp.models.ik.subproblems import next_to
from feasigrasp.models.numerics.small_cholesky import cholesky_kernel, cholesky_solve_kernel
from feasigrasp.models.robot.arm import LOWER, SEEDS, UPPER
from feasigrasp.models.robot.kinematics import pose_jacobian_kernel

#: Errors of place count as this much of an angle [rad/m]. Source: numerical.
_PLACE = 3.0


@compiled
def _error_kernel(X_WF, X, e):
    """Writes the error (6,) of a pose: turn [rad] and place, weighted. Returns its square."""
    s, trace = (0.0, 0.0, 0.0), 0.0
    for k in range(3):
        a, b = (X[0, k], X[1, k], X[2, k]), (X_WF[0, k], X_WF[1, k], X_WF[2, k])
        s = (
            s[0] + a[1] * b[2] - a[2] * b[1],
            s[1] + a[2] * b[0] - a[0] * b[2],
            s[2] + a[0] * b[1] - a[1] * b[0],
        )
        trace += a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    sine, square = math.sqrt(s[0] * s[0] + s[1] * s[1] + s[2] * s[2]), 0.0
    scale = math.atan2(sine, trace - 1.0) / sine if sine > 1e-12 else 0.5
    if sine <= 1e-12 and trace < 0.0:  # half a turn off: any axis leads away from there
        s, scale = (1.0, 1.0, 1.0), 0.5 * math.pi
    for i in range(3):
        e[i], e[3 + i] = scale * s[i], _PLACE * (X_WF[i, 3] - X[i, 3])
        square += e[i] * e[i] + e[3 + i] * e[3 + i]
    return square


@compiled
def least_squares_kernel(chain, X_WF, free, q):
    """Moves the first ``free`` joints of ``q`` (n,) to a flange pose; False if they fail."""
    # Square of the error that ends the steps; after six, so does one that leaves more than this
    # share of it. And lambda over |e|^2.
    solved, stalled, damping = 1e-20, 0.9, 0.01
    n = len(chain) - 1
    X, J, e, tool = np.empty((4, 4)), np.empty((6, n)), np.empty(6), np.eye(4)
    A, y, last = np.empty((6, 6)), np.empty(6), np.inf
    for count in range(14):
        pose_jacobian_kernel(chain, q, tool, X, J)
        square = _error_kernel(X_WF, X, e)
        if square < solved:
            return True
        if not square < (np.inf if count < 6 else stalled * last):
            return False
        last = square
        for i in range(3):
            for j in range(free):
                J[3 + i, j] *= _PLACE
        for i in range(6):
            for k in range(i + 1):
                A[i, k] = damping * square + 1e-12 if i == k else 0.0
                for j in range(free):
                    A[i, k] += J[i, j] * J[k, j]
            y[i] = e[i]
        cholesky_kernel(A, A, 1e-15)
        cholesky_solve_kernel(A, y)
        for j in range(free):
            way = 0.0
            for i in range(6):
                way += J[i, j] * y[i]
            q[j] = min(max(q[j] + min(max(way, -1.0), 1.0), chain[j, LOWER]), chain[j, UPPER])
    return False


@compiled
def nearest_seeds_kernel(chain, X_WF, found):
    """Writes the seeds (k,) whose flange poses are nearest to one, the nearest first."""
    m, count = (chain.shape[1] - SEEDS) // 2, len(found)
    w, i, j, k = quaternion_kernel(X_WF)
    cost, apart = np.full(count, np.inf), np.empty(m)
    p, f = (X_WF[0, 3], X_WF[1, 3], X_WF[2, 3]), chain[:, SEEDS : SEEDS + m]
    for s in range(m):
        x, y, z = f[0, s] - p[0], f[1, s] - p[1], f[2, s] - p[2]
        dot = w * f[6, s] + i * f[3, s] + j * f[4, s] + k * f[5, s]
        # |turn|^2 = 8 (1 - |dot|) of small ones.
        apart[s] = _PLACE * _PLACE * (x * x + y * y + z * z) - 8.0 * abs(dot)
    found[:] = 0
    for s in range(m):
        if apart[s] < cost[count - 1]:
            at = count - 1
            while at > 0 and cost[at - 1] > apart[s]:
                cost[at], found[at] = cost[at - 1], found[at - 1]
                at -= 1
            cost[at], found[at] = apart[s], s


@compiled
def seed_configurations_kernel(chain, seeds, q_near, found):
    """Writes the configurations (k + 1, n) of k seeds, next to ``q_near``, and that itself."""
    m = (chain.shape[1] - SEEDS) // 2
    found[:] = q_near
    for k in range(len(found) - 1):
        for j in range(len(q_near)):
            found[k, j] = next_to(chain[j, SEEDS + m + seeds[k]], chain, j, q_near[j])


@compiled
def from_seed_kernel(chain, X_WF, seed, q):
    """Writes a configuration (n,) of a pose, of any redundancy, next to what ``q`` held.

    It is found from a seed, or from ``q`` itself where the seed is negative. False without one.
    """
    n, m = len(chain) - 1, (chain.shape[1] - SEEDS) // 2
    one = q.copy()
    for j in range(n if seed >= 0 else 0):
        one[j] = chain[j, SEEDS + m + seed]
    if not least_squares_kernel(chain, X_WF, n, one):
        return False
    for j in range(n):
        q[j] = next_to(one[j], chain, j, q[j])
    return True


@compiled
def seeded_kernel(chain, X_WF, branch, redundancy, q):
    """Writes the configuration (n,) of a branch, next to what ``q`` held. False without one.

    The search begins at ``q`` if that is nearer to the pose than the seed.
    """
    n, m = len(chain) - 1, (chain.shape[1] - SEEDS) // 2
    one, own, X, e, tool = q.copy(), np.empty(n), np.empty((4, 4)), np.empty(6), np.eye(4)
    for j in range(n):
        own[j] = chain[j, SEEDS + m + min(branch, m - 1)]
    for j in range(6, n):
        one[j] = own[j] = redundancy
    pose_jacobian_kernel(chain, one, tool, X, None)
    square = _error_kernel(X_WF, X, e)
    pose_jacobian_kernel(chain, own, tool, X, None)
    if not square < _error_kernel(X_WF, X, e):
        one[:] = own
    if not least_squares_kernel(chain, X_WF, 6, one):
        return False
    for j in range(n):
        q[j] = next_to(one[j], chain, j, q[j])
    return True


@compiled
def seed_of_kernel(chain, q):
    """The seed nearest to a configuration (n,) from which `seeded_kernel` leads to it."""
    n, m = len(chain) - 1, (chain.shape[1] - SEEDS) // 2
    apart, X, one, r = np.zeros(m), np.empty((4, 4)), np.empty(n), q[n - 1]
    pose_jacobian_kernel(chain, q, np.eye(4), X, None)
    for j in range(n):
        for s in range(m):
            apart[s] += (chain[j, SEEDS + m + s] - q[j]) ** 2
    first = np.argmin(apart)
    for _ in range(4):
        best = np.argmin(apart)
        for j in range(n):
            one[j] = chain[j, SEEDS + m + best] if j < 6 else r
        if least_squares_kernel(chain, X, 6, one) and np.max(np.abs(np.sin(one - q))) < 1e-3:
            return best
        apart[best] = np.inf
    return first
