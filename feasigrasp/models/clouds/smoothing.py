"""Smoothing of one depth view by local fits, and its registration to the merged views.

A depth camera errs along its rays. So around every point the depth towards the camera is fitted as
a quadratic function of the position across the line of sight (moving least squares; a plane
would round off what is curved), with far neighbours and outliers weighing less. The noisier the
view, the more neighbours.
"""

import numpy as np
from scipy.spatial import cKDTree

from feasigrasp.models.arrays import Array, Indices
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry import se3
from feasigrasp.models.numerics.small_cholesky import cholesky_kernel, cholesky_solve_kernel

#: Points pair up if closer than this, in the first and the last step [m]. Source: guessed.
_GATE = (0.01, 0.004)


def register_view(
    points: Array, normals: Array, model_points: Array, model_normals: Array
) -> Array:
    """Finds the small motion that brings a view onto the model of merged earlier views.

    Gauss-Newton steps on the distances to the model's tangent planes (Chen & Medioni, "Object
    modelling by registration of multiple range images", 1992), with the tracked pose as a Gaussian
    prior: what the overlap does not determine, like the turn of a can about its axis, stays as
    tracked.

    Both are smoothed points [m] with their unit normals, shapes (n, 3) and (m, 3).

    Returns:
        The correction to apply to the view, shape (4, 4). The identity if there is too little
        overlap, if it hardly improves the fit, or if it is larger than tracking errors are.
    """
    # Fewer pairs determine no pose.
    min_pairs, steps = 30, 6
    # Noise of a residual, sensor and smoothing together [m].
    residual_sigma = 1.5e-3
    # Points of the view that are used, at most; they are spread over it.
    every = -(-len(points) // 400)
    points, normals = points[::every], normals[::every]
    tree, center = cKDTree(model_points), model_points.mean(axis=0)
    # Standard deviation of the tracked pose that is reckoned with: [rad] and [m], per axis.
    tracked_sigma = np.deg2rad(1.0), 2e-3
    sigma = np.repeat(tracked_sigma, 3)
    total = np.eye(4)
    for gate in np.linspace(*_GATE, steps):
        moved = points @ total[:3, :3].T + total[:3, 3]
        turned = normals @ total[:3, :3].T
        distance, nearest = tree.query(moved, distance_upper_bound=gate)
        found = np.flatnonzero(np.isfinite(distance))
        other = nearest[found]
        # Pairs count if the cosine between their normals is larger than this.
        same = np.einsum("ij,ij->i", turned[found], model_normals[other]) > 0.7
        found, other = found[same], other[same]
        if len(found) < min_pairs:
            return np.eye(4)
        n = turned[found] + model_normals[other]
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        residual = np.einsum("ij,ij->i", moved[found] - model_points[other], n)
        weight = 1.0 / (1.0 + (residual / (2.0 * residual_sigma)) ** 2) ** 2
        jacobian = np.hstack([np.cross(moved[found] - center, n), n])
        weighted = jacobian * (weight / residual_sigma**2)[:, None]
        so_far = _about(se3.log(total), center)
        hessian = weighted.T @ jacobian + np.diag(sigma**-2)
        step = -np.linalg.solve(hessian, weighted.T @ residual + so_far / sigma**2)
        total = _exp_about(step, center) @ total
    corrected, tracked = (
        _spread(points, X, tree, model_points, model_normals) for X in (total, np.eye(4))
    )
    # A correction beyond this many standard deviations is a wrong one.
    too_far = np.abs(_about(se3.log(total), center)) > 4.0 * np.sqrt(2.0) * sigma
    # A correction that leaves more than this of the misfit follows noise, not an error of the
    # tracker.
    left = 0.95
    return np.eye(4) if too_far.any() or corrected >= left * tracked else total


def _spread(
    points: Array, X: Array, tree: cKDTree, model_points: Array, model_normals: Array
) -> float:
    """Mean distance of the view's points to the model's tangent planes, outliers cut off."""
    moved = points @ X[:3, :3].T + X[:3, 3]
    nearest = tree.query(moved)[1]
    offset = np.abs(np.einsum("ij,ij->i", moved - model_points[nearest], model_normals[nearest]))
    apart = np.linalg.norm(moved - model_points[nearest], axis=1)
    return float(np.where(apart < _GATE[0], np.minimum(offset, _GATE[1]), _GATE[1]).mean())


def _exp_about(v: Array, center: Array) -> Array:
    """Motion by the twist v = [angular; linear] about a center instead of the origin, (4, 4)."""
    X = se3.exp(v)
    X[:3, 3] += center - X[:3, :3] @ center
    return X


def _about(v: Array, center: Array) -> Array:
    """The twist of the same motion taken about a center."""
    return np.concatenate([v[:3], v[3:] + np.cross(v[:3], center)])


def smooth_view(cloud: Array, at: Array, p_OC: Array) -> tuple[Array, Array, Array]:
    """Puts points ``at`` (m, 3) onto the smooth surface through a view's cloud near them (n, 3).

    The camera is at p_OC (3,) [m].

    Returns:
        Points moved along their lines of sight and unit normals on the camera's side, (m, 3) each,
        and standard deviations of the points along the lines of sight, (m,) [m].
    """
    # No point moves further than this; where it would, the patch is no surface [m].
    max_shift = 0.006
    # Neighbours farther away hardly count, however sparse the view [m].
    max_radius = 0.01
    # Where they err w times as much, w at most the first, patches have these powers of w more
    # neighbours and are wider: normals would turn with the noise.
    widest, more, farther = 1.6, 5.0, 1.5
    # Neighbours that a patch is fitted to, if depths err by at most so much [m].
    neighbours, usual_noise = 32, 1.7e-3
    # Above this many points of a view, every second (third, ...) one is used.
    thin = np.ascontiguousarray(cloud[:: -(-len(cloud) // 4000)])
    at, camera = np.ascontiguousarray(at), np.asarray(p_OC, dtype=float)
    tree = cKDTree(thin)

    def patches(where: Array, count: int, radius: float, most: float) -> tuple[Array, ...]:
        distance, near = tree.query(where, k=count)
        return _fit_patches(thin, where, camera, near, distance, radius, most)

    # Number of patches from which the noise is estimated.
    some = np.ascontiguousarray(at[:: max(1, len(at) // 100)])
    noise = float(np.median(patches(some, min(neighbours, len(thin)), max_radius, max_shift)[2]))
    wider = min(max(noise / usual_noise, 1.0), widest)
    count = min(round(neighbours * wider**more), len(thin))
    # If depths err much, no point moves further than a multiple of their standard deviation.
    most = max(max_shift, 4.0 * noise)
    points, normals, spread = patches(at, count, max_radius * wider**farther, most)
    # Errors of neighbours correlate, far pixels count less: this number counts as one.
    return points, normals, spread * np.sqrt(12.0 / count)


@compiled
def _fit_patches(
    cloud: Array, at: Array, p_OC: Array, near: Indices, distance: Array, radius: float, most: float
) -> tuple[Array, Array, Array]:
    """Smoothed points, normals, and how far the neighbours are from the patches."""
    m, k = near.shape
    points, normals, scatter = at.copy(), np.empty_like(at), np.empty(m)
    basis, weight, height = np.empty((6, k)), np.empty(k), np.empty(k)
    weighted, residual = np.empty(k), np.empty(k)
    matrix, right = np.empty((6, 6)), np.empty(6)
    for i in range(m):
        z = p_OC - at[i]
        z = z / np.sqrt(z @ z)
        x = np.zeros(3)
        x[np.argmin(np.abs(z))] = 1.0
        x = x - (x @ z) * z
        x = x / np.sqrt(x @ x)
        y = np.cross(z, x)
        size = max(min(distance[i, k - 1], radius), 1e-9)
        for j in range(k):
            n = near[i, j]
            dx, dy, dz = cloud[n, 0] - at[i, 0], cloud[n, 1] - at[i, 1], cloud[n, 2] - at[i, 2]
            u = (dx * x[0] + dy * x[1] + dz * x[2]) / size
            v = (dx * y[0] + dy * y[1] + dz * y[2]) / size
            height[j] = dx * z[0] + dy * z[1] + dz * z[2]
            basis[0, j], basis[1, j], basis[2, j] = 1.0, u, v
            basis[3, j], basis[4, j], basis[5, j] = u * u, u * v, v * v
            weight[j] = np.exp(-0.5 * (distance[i, j] / (0.6 * size)) ** 2)
        for again in range(2):
            if again:
                for j in range(k):
                    residual[j] = height[j]
                    for a in range(6):
                        residual[j] -= right[a] * basis[a, j]
                # Depth noise below which a residual is no outlier, whatever the others are [m].
                scatter[i] = max(1.4826 * np.median(np.abs(residual)), 2e-4)
                spread = 2.0 * scatter[i]
                for j in range(k):
                    weight[j] /= (1.0 + (residual[j] / spread) ** 2) ** 2
            for a in range(6):
                for j in range(k):
                    weighted[j] = weight[j] * basis[a, j]
                right[a] = _dot(weighted, height)
                for b in range(a + 1):
                    matrix[a, b] = _dot(weighted, basis[b])
            total = matrix[0, 0]
            for a in range(6):
                # Weight of the penalty on curvature against that of the neighbours.
                matrix[a, a] += total * (1e-2 if a > 2 else 1e-6)
            cholesky_kernel(matrix, matrix, 1e-18)
            cholesky_solve_kernel(matrix, right)
        if abs(right[0]) < most:
            points[i] = at[i] + right[0] * z
        normal = z - (right[1] / size) * x - (right[2] / size) * y
        normals[i] = normal / np.sqrt(normal @ normal)
    return points, normals, scatter


@compiled(forceinline=True, fastmath=True)
def _dot(a: Array, b: Array) -> float:
    s = 0.0
    for j in range(len(a)):
        s += a[j] * b[j]
    return s
