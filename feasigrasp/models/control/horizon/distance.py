"""Distance field over inverse kinematics solutions, along a plan (paper section IV-D.2).

The paper's law ``qd = -d grad d`` leads down the distance d of a Gaussian process to the solutions
of many grasps. Here its step is the target of every knot: the cost ``w / 2 d^2`` is bounded from
above by ``w / 2 |q - (q_0 - d grad d)|^2`` about the plan before, q_0, with the solutions of the
grasps near the selected one at the object's predicted pose.

The process is that for shapes, with the kernel ``exp(-|q - q_i| / l)``, over the inverse
kinematics solutions q_i of many grasps: its distance ``d = -l ln o`` is a potential with one
equilibrium per solution. The length scale follows the spacing of the solutions, since neighbours
that are closer than l blend into one equilibrium that is no solution.

The paper fits ``o(q_i) = 1``, so that ``d(q_i) = 0``. Here ``d(q_i) = c_i``, what it will cost to
be there [rad]: far from all solutions ``d = min_i (|q - q_i| + c_i)``, smoothly. With all c_i = 0
it is the paper's field. A solution with ``c_i > c_j + |q_i - q_j|`` is never worth going to: its
cost is taken as the right-hand side, so that the field passes through it as if it were not there.
"""

import numpy as np

from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry.se3_kernels import compose_kernel, inverse_kernel
from feasigrasp.models.grasps.approach_corridor import standoff_kernel
from feasigrasp.models.ik.continuation import flange_pose_kernel, solve_kernel
from feasigrasp.models.ik.self_motion import inside_limits_kernel
from feasigrasp.models.numerics.fast_math import fast_exp
from feasigrasp.models.robot.arm import MARGIN

#: Bounds of the length scale [rad], and its ratio to the median nearest-neighbour spacing. Source:
#: guessed.
MIN_LENGTH_SCALE, MAX_LENGTH_SCALE, SPACING_RATIO = 0.03, 0.2, 0.4
#: Variance of the noise that keeps the matrix of solutions that coincide regular. Source:
#: numerical.
NOISE_VARIANCE = 1e-6

_FAST = {"reassoc", "contract", "nsz", "arcp"}


@compiled(forceinline=True, fastmath=_FAST)
def distances_kernel(q, r):
    """Writes the distances |q_i - q_j|, i > j, into the lower triangle of ``r`` (n, n)."""
    n, joints = q.shape
    columns = np.empty((joints, n))
    for k in range(joints):
        for i in range(n):
            columns[k, i] = q[i, k]
    for i in range(n):
        row = r[i]
        for j in range(i):
            row[j] = 0.0
        for k in range(joints):
            column, here = columns[k], columns[k, i]
            for j in range(i):
                offset = here - column[j]
                row[j] += offset * offset
        for j in range(i):
            row[j] = np.sqrt(row[j])


@compiled
def length_scale_kernel(r):
    """The length scale for distances (n, n), of which the lower triangle is read."""
    n = len(r)
    if n < 2:
        return MAX_LENGTH_SCALE
    nearest = np.full(n, np.inf)
    for i in range(n):
        for j in range(i):
            nearest[i] = min(nearest[i], r[i, j])
            nearest[j] = min(nearest[j], r[i, j])
    return min(max(SPACING_RATIO * np.median(nearest), MIN_LENGTH_SCALE), MAX_LENGTH_SCALE)


@compiled(forceinline=True, fastmath=_FAST)
def lowest_costs_kernel(r, cost, lowest):
    """Writes ``min_j (c_j + |q_i - q_j|)``; returns the least cost."""
    n = len(cost)
    least = np.inf
    for i in range(n):
        lowest[i] = cost[i]
        least = min(least, cost[i])
    for i in range(n):
        row, mine, best = r[i], cost[i], lowest[i]
        for j in range(i):
            best = min(best, cost[j] + row[j])
            lowest[j] = min(lowest[j], mine + row[j])
        lowest[i] = best
    return least


@compiled(forceinline=True, fastmath=_FAST)
def _exponentials(r, length_scale):
    """Replaces the distances by the kernel's values."""
    scale = -1.0 / length_scale
    for i in range(len(r)):
        row = r[i]
        for j in range(i):
            row[j] = fast_exp(scale * row[j])


@compiled(forceinline=True, fastmath=_FAST)
def _solve(K, diagonal, x):
    """Replaces x by ``(K + diagonal I)^-1 x``; K (n, n), lower triangle, becomes its factor.

    By rows, so that the inner loops run over contiguous memory: up to a hundred solutions this is
    quicker than a call of LAPACK, and no second thread can come of it.
    """
    n = len(x)
    for i in range(n):
        row = K[i]
        pivot, y = diagonal, x[i]
        for j in range(i):
            other = K[j]
            dot = row[j]
            for k in range(j):
                dot -= row[k] * other[k]
            row[j] = dot * other[j]  # the diagonal holds the reciprocals
        for k in range(i):
            pivot -= row[k] * row[k]
            y -= row[k] * x[k]
        row[i] = 1.0 / np.sqrt(max(pivot, 1e-12))
        x[i] = y * row[i]
    for i in range(n - 1, -1, -1):
        row = K[i]
        x[i] *= row[i]
        y = x[i]
        for k in range(i):
            x[k] -= row[k] * y


@compiled(forceinline=True)
def fit_kernel(r, cost, length_scale, noise_variance, lowest, beta):
    """Fits the field to solutions at distances ``r`` (n, n), which are used up.

    Writes the costs as they count, ``lowest`` (n,), and the weights ``beta`` (n,):
    ``o(q) = sum_i beta_i exp(-(|q - q_i| + c_i) / l)``. In that form nothing underflows: the
    weights of the process are ``beta_i exp(-c_i / l)``.
    """
    least = lowest_costs_kernel(r, cost, lowest)
    _exponentials(r, length_scale)
    for i in range(len(cost)):
        beta[i] = np.exp((least - lowest[i]) / length_scale)
    _solve(r, 1.0 + noise_variance, beta)
    for i in range(len(cost)):
        beta[i] *= np.exp((lowest[i] - least) / length_scale)


@compiled
def evaluate_kernel(q, nodes, lowest, beta, length_scale, gradient, weights):
    """Writes grad d (7,) and the solution weights (n,); returns d and the remaining distance.

    All terms are relative to the largest one (log-sum-exp). The way left is ``d`` less the cost of
    the solutions that count: zero at each of them.
    """
    n = len(nodes)
    nearest = np.inf
    for i in range(n):
        square = 0.0
        for k in range(len(q)):
            square += (q[k] - nodes[i, k]) ** 2
        weights[i] = np.sqrt(square)
        nearest = min(nearest, weights[i] + lowest[i])
    o = total = mean_cost = soft = 0.0
    gradient[:] = 0.0
    for i in range(n):
        r = weights[i]
        decay = np.exp((nearest - r - lowest[i]) / length_scale)
        term = beta[i] * decay
        o += term
        soft += decay
        for k in range(len(q)):
            gradient[k] += term / max(r, 1e-12) * (q[k] - nodes[i, k])
        # What says which solution counts decays four times faster than the field: where a solution
        # is an equilibrium, its weight is 1 and the others' are nothing.
        decay = decay * decay
        weights[i] = decay * decay
        total += weights[i]
        mean_cost += weights[i] * lowest[i]
    if o <= 1e-12 * soft:
        # Only rounding of a nearly singular matrix leads here.
        o = total
        gradient[:] = 0.0
        for i in range(n):
            offset = q - nodes[i]
            gradient += weights[i] * offset / max(np.linalg.norm(offset), 1e-12)
    for i in range(n):
        weights[i] /= total
    for k in range(len(q)):
        gradient[k] /= o
    d = nearest - length_scale * np.log(o)
    return d, d - mean_cost / total


@compiled
def distance_kernel(knots, grasps, corridor, X_GF, options, form):
    """Adds the quadratic forms of all knots; ``options`` are those of the program.

    A solution costs ``speed penalty`` [rad]. A knot at which no grasp has a solution adds nothing.
    """
    o, n, count = options[0], knots.q.shape[1], len(grasps.X_OG)
    X_WF, found, cost = np.empty((4, 4)), np.empty((count, n)), np.empty(count)
    gradient, part = np.empty(n), np.empty(count)
    for k in range(len(knots.q)):
        X_OH, m = compose_kernel(inverse_kernel(knots.X_WO[k]), knots.X_WH[k]), 0
        for i in range(count):
            back = knots.share[k] * standoff_kernel(grasps.X_OG[i], X_OH, corridor)
            flange_pose_kernel(knots.X_WO[k], grasps.X_OG[i], back, X_GF, X_WF)
            found[m] = knots.q[k]
            reached = solve_kernel(knots.chain, X_WF, grasps.branch[i], grasps.psi[i], found[m])
            margin = knots.chain[0, MARGIN]
            if reached and inside_limits_kernel(knots.chain, found[m], margin):
                cost[m] = o.speed * grasps.penalty[i]
                m += 1
        if m == 0:
            continue
        nodes, r, beta, lowest = found[:m], np.empty((m, m)), np.empty(m), np.empty(m)
        distances_kernel(nodes, r)
        length_scale = length_scale_kernel(r)
        fit_kernel(r, cost[:m], length_scale, NOISE_VARIANCE, lowest, beta)
        _, left = evaluate_kernel(knots.q[k], nodes, lowest, beta, length_scale, gradient, part[:m])
        for j in range(n):
            form.g[k, j] += o.distance * max(left, 0.0) * gradient[j]
            form.H[k, j, j] += o.distance
