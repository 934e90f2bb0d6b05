"""Clearance of the open hand to the moving object, along a plan: what leads it round the object.

Points of the hand nearer to the object's surface than the clearance, at the object's predicted
pose, cost the square of what is missing (a hinge, as in CHOMP: Zucker et al., IJRR 2013)::

    c(q) = w / 2 sum_i max(0, clearance - distance(p_i(q)))^2
"""

from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry.obstacle_grid import grid_kernel
from feasigrasp.models.geometry.se3_kernels import compose_kernel, inverse_kernel
from feasigrasp.models.grasps.approach_corridor import extra_clearance_kernel
from feasigrasp.models.robot.iiwa import IIWA_7


@compiled
def clearance_kernel(
    X_WH, J_WH, X_WO, X_OG, points, values, frame, clearance, corridor, weight, H, g
):
    """Adds the quadratic forms of all knots to Hessians H (N, 7, 7) and gradients g (N, 7).

    ``X_WH`` (N, 4, 4) and ``J_WH`` (N, 6, 7) are the hand's poses and Jacobians, ``X_WO``
    (N, 4, 4) the object's poses, ``X_OG`` (M, 4, 4) the grasps, ``points`` (k, 3) those of the
    hand, in H; ``values`` and ``frame`` of the object's `ObstacleGrid`. The clearance [m] is the
    larger the less the hand is lined up.
    """
    n = IIWA_7.joints
    for k in range(len(X_WH)):
        X_OH = compose_kernel(inverse_kernel(X_WO[k]), X_WH[k])
        least = clearance + extra_clearance_kernel(X_OG, X_OH, corridor)
        for i in range(len(points)):
            x, y, z = points[i]
            p_O = (
                X_OH[0, 0] * x + X_OH[0, 1] * y + X_OH[0, 2] * z + X_OH[0, 3],
                X_OH[1, 0] * x + X_OH[1, 1] * y + X_OH[1, 2] * z + X_OH[1, 3],
                X_OH[2, 0] * x + X_OH[2, 1] * y + X_OH[2, 2] * z + X_OH[2, 3],
            )
            distance, slope = grid_kernel(p_O, values, frame)
            missing = least - distance
            if missing <= 0.0:
                continue
            _add(X_WH[k], J_WH[k], X_WO[k], (x, y, z), slope, missing, weight, n, H[k], g[k])


@compiled(forceinline=True)
def _add(X_WH, J_WH, X_WO, p_H, slope_O, missing, weight, n, H, g):
    """Adds the form of one point, with the slope of the distance in O."""
    s0 = X_WO[0, 0] * slope_O[0] + X_WO[0, 1] * slope_O[1] + X_WO[0, 2] * slope_O[2]
    s1 = X_WO[1, 0] * slope_O[0] + X_WO[1, 1] * slope_O[1] + X_WO[1, 2] * slope_O[2]
    s2 = X_WO[2, 0] * slope_O[0] + X_WO[2, 1] * slope_O[1] + X_WO[2, 2] * slope_O[2]
    r0 = X_WH[0, 0] * p_H[0] + X_WH[0, 1] * p_H[1] + X_WH[0, 2] * p_H[2]
    r1 = X_WH[1, 0] * p_H[0] + X_WH[1, 1] * p_H[1] + X_WH[1, 2] * p_H[2]
    r2 = X_WH[2, 0] * p_H[0] + X_WH[2, 1] * p_H[1] + X_WH[2, 2] * p_H[2]
    m0, m1, m2 = r1 * s2 - r2 * s1, r2 * s0 - r0 * s2, r0 * s1 - r1 * s0
    for a in range(n):
        row_a = m0 * J_WH[0, a] + m1 * J_WH[1, a] + m2 * J_WH[2, a]
        row_a += s0 * J_WH[3, a] + s1 * J_WH[4, a] + s2 * J_WH[5, a]
        g[a] -= weight * missing * row_a
        for b in range(n):
            row_b = m0 * J_WH[0, b] + m1 * J_WH[1, b] + m2 * J_WH[2, b]
            row_b += s0 * J_WH[3, b] + s1 * J_WH[4, b] + s2 * J_WH[5, b]
            H[a, b] += weight * row_a * row_b
