"""Clearance of the open hand to the moving object, along a plan: what leads it round the object.

Points of the hand nearer to the object's surface than the clearance, at the object's predicted
pose, cost the square of what is missing (a hinge, as in CHOMP: Zucker et al., IJRR 2013)::

    c(q) = w / 2 sum_i max(0, clearance - distance(p_i(q)))^2
"""

import numpy as np

from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry.obstacle_grid import grid_kernel
from feasigrasp.models.geometry.se3_kernels import compose_kernel, inverse_kernel
from feasigrasp.models.grasps.approach_corridor import extra_clearance_kernel


@compiled
def clearance_kernel(knots, grasps, surface, corridor, weight, form):
    """Adds the quadratic forms of all knots, with the weight w [1/m^2].

    The clearance is the larger the less the hand is lined up with one of the grasps.
    """
    n = knots.q.shape[1]
    row = np.empty(n)
    for k in range(len(knots.q)):
        X_WH, H, g = knots.X_WH[k], form.H[k], form.g[k]
        X_OH = compose_kernel(inverse_kernel(knots.X_WO[k]), X_WH)
        least = surface.clearance + extra_clearance_kernel(grasps.X_OG, X_OH, corridor)
        for i in range(len(surface.hand)):
            x, y, z = surface.hand[i]
            p_O = (
                X_OH[0, 0] * x + X_OH[0, 1] * y + X_OH[0, 2] * z + X_OH[0, 3],
                X_OH[1, 0] * x + X_OH[1, 1] * y + X_OH[1, 2] * z + X_OH[1, 3],
                X_OH[2, 0] * x + X_OH[2, 1] * y + X_OH[2, 2] * z + X_OH[2, 3],
            )
            distance, slope = grid_kernel(p_O, surface.values, surface.frame)
            missing = least - distance
            if missing <= 0.0:
                continue
            _slope_kernel(X_WH, knots.J_WH[k], knots.X_WO[k], (x, y, z), slope, row)
            for a in range(n):
                g[a] -= weight * missing * row[a]
                for b in range(n):
                    H[a, b] += weight * row[a] * row[b]


@compiled(forceinline=True)
def _slope_kernel(X_WH, J_WH, X_WO, p_H, slope_O, row):
    """Writes the slope (7,) of the distance at a point of the hand, by the joints [m/rad]."""
    s0 = X_WO[0, 0] * slope_O[0] + X_WO[0, 1] * slope_O[1] + X_WO[0, 2] * slope_O[2]
    s1 = X_WO[1, 0] * slope_O[0] + X_WO[1, 1] * slope_O[1] + X_WO[1, 2] * slope_O[2]
    s2 = X_WO[2, 0] * slope_O[0] + X_WO[2, 1] * slope_O[1] + X_WO[2, 2] * slope_O[2]
    r0 = X_WH[0, 0] * p_H[0] + X_WH[0, 1] * p_H[1] + X_WH[0, 2] * p_H[2]
    r1 = X_WH[1, 0] * p_H[0] + X_WH[1, 1] * p_H[1] + X_WH[1, 2] * p_H[2]
    r2 = X_WH[2, 0] * p_H[0] + X_WH[2, 1] * p_H[1] + X_WH[2, 2] * p_H[2]
    m0, m1, m2 = r1 * s2 - r2 * s1, r2 * s0 - r0 * s2, r0 * s1 - r1 * s0
    for j in range(len(row)):
        row[j] = m0 * J_WH[0, j] + m1 * J_WH[1, j] + m2 * J_WH[2, j]
        row[j] += s0 * J_WH[3, j] + s1 * J_WH[4, j] + s2 * J_WH[5, j]
