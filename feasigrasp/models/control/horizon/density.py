"""Negative log density of a Riemannian mixture over grasps, along a plan (paper section IV-D.1).

Every grasp near the selected one is a component of heavy tails, a Student's t on SE(3)::

    p(X) = sum_m w_m (1 + d_m)^-nu,    d_m = |e_p|^2 / k_p^2 + |e_r|^2 / k_r^2

with the position and rotation errors of the hand X to the grasp m at the object's predicted pose,
pulled back by the approach corridor. About the plan before, each step of expectation maximization
bounds ``-log p`` from above by a quadratic form (iteratively reweighted least squares; Lange et
al., "Robust statistical modeling using the t distribution", JASA 1989): the grasps count by their
responsibilities, and errors far away by ``1 / (1 + d)``. So which of the neighbours the hand goes
for is never decided; it follows from the density.
"""

import numpy as np

from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry.se3_kernels import compose_kernel, inverse_kernel, so3_log_kernel
from feasigrasp.models.grasps.approach_corridor import standoff_kernel


@compiled
def density_kernel(knots, grasps, corridor, X_GF, options, form):
    """Adds the quadratic forms of all knots; ``options`` are those of the program.

    The weight of a grasp is ``exp(-worth penalty)``. ``X_GF`` has no effect: both costs are
    called alike.
    """
    o, n, X_OG = options[0], knots.q.shape[1], grasps.X_OG
    W, X_OT, e = np.empty(6), np.empty((4, 4)), np.empty((len(X_OG), 6))
    W[:3], W[3:] = 2.0 * o.tail / o.tail_angle**2, 2.0 * o.tail / o.tail_position**2
    log_p, reweighted, mean = np.empty(len(X_OG)), np.empty(len(X_OG)), np.empty(6)
    for k in range(len(knots.q)):
        X_WH, J_WH, H, g = knots.X_WH[k], knots.J_WH[k], form.H[k], form.g[k]
        X_OH = compose_kernel(inverse_kernel(knots.X_WO[k]), X_WH)
        for m in range(len(X_OG)):
            back = knots.share[k] * standoff_kernel(X_OG[m], X_OH, corridor)
            X_OT[:] = X_OG[m]
            for i in range(3):
                X_OT[i, 3] -= back * X_OG[m, i, 2]
            X_WT = compose_kernel(knots.X_WO[k], X_OT)
            e[m, :3] = so3_log_kernel(compose_kernel(X_WH, inverse_kernel(X_WT))[:3, :3])
            e[m, 3:] = X_WH[:3, 3] - X_WT[:3, 3]
            d = np.sum(e[m, :3] ** 2) / o.tail_angle**2 + np.sum(e[m, 3:] ** 2) / o.tail_position**2
            log_p[m] = -o.worth * grasps.penalty[m] - o.tail * np.log1p(d)
            reweighted[m] = 1.0 / (1.0 + d)
        responsibility = np.exp(log_p - np.max(log_p))
        responsibility /= np.sum(responsibility)
        total = 0.0
        mean[:] = 0.0
        for m in range(len(X_OG)):
            total += responsibility[m] * reweighted[m]
            mean += responsibility[m] * reweighted[m] * e[m]
        for j in range(n):
            for a in range(6):
                g[j] += J_WH[a, j] * W[a] * mean[a]
                for i in range(n):
                    H[j, i] += J_WH[a, j] * W[a] * total * J_WH[a, i]
