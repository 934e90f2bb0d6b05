"""Rigid motions SE(3): exponential, logarithm and its derivative, over any leading axes.

A tangent vector is ``v = [w; u]``, angular part first [rad; m]; a pose is a 4x4 matrix. The
logarithm is that of the *group* (a screw), so ``exp(log(X)) = X`` for every pose, and a distance
built from ``log(inverse(X) @ Y)`` does not change when both poses move together. Everything is
accurate at rotation angle zero and up to pi inclusive.

Functions work on arrays ``(..., 6)`` or ``(..., 4, 4)`` and return a new array. Rotations are taken
as they are, and NaN gives NaN; another shape raises an `ArgumentError`. The same for one
element, to be called from other numba code, is in `feasigrasp.models.geometry.se3_kernels`.
"""

from collections.abc import Callable
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.errors import ArgumentError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry.se3_kernels import (
    exp_kernel,
    inverse_kernel,
    log_kernel,
    quaternion_kernel,
    right_jacobian_inverse_kernel,
    rotation_kernel,
    so3_exp_kernel,
    so3_log_kernel,
)
from feasigrasp.models.quantities import ArrayOf, Whole

_VECTOR3, _VECTOR6 = ArrayOf(("...", 3), finite=False), ArrayOf(("...", 6), finite=False)
_MATRIX3, _POSES = ArrayOf(("...", 3, 3), finite=False), ArrayOf(("...", 4, 4), finite=False)
_POSE, _TWIST = ArrayOf((4, 4), finite=False), ArrayOf((6,), finite=False)
_QUATERNIONS = ArrayOf(("...", 4), finite=False)


@checked()
def exp(v: Annotated[ArrayLike, _VECTOR6]) -> Array:
    """Poses (..., 4, 4) of tangent vectors (..., 6)."""
    return _map(_exp, v, 1, (4, 4))


@checked()
def log(X: Annotated[ArrayLike, _POSES]) -> Array:
    """Tangent vectors (..., 6) of poses (..., 4, 4); the angular part is at most pi long.

    At exactly pi the axis is right and its sign, which is then free, is arbitrary.
    """
    return _map(_log, X, 2, (6,))


@checked()
def inverse(X: Annotated[ArrayLike, _POSES]) -> Array:
    """Inverses of poses (..., 4, 4), from the transposed rotation."""
    return _map(_inverse, X, 2, (4, 4))


@checked()
def right_jacobian_inverse(v: Annotated[ArrayLike, _VECTOR6]) -> Array:
    """J_r^-1 (..., 6, 6): ``log(exp(v) exp(e)) = v + J_r^-1(v) e`` to first order.

    Singular at a rotation of 2 pi only.
    """
    return _map(_right_jacobian_inverse, v, 1, (6, 6))


@checked()
def so3_exp(w: Annotated[ArrayLike, _VECTOR3]) -> Array:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3) [rad]."""
    return _map(_so3_exp, w, 1, (3, 3))


@checked()
def so3_log(R: Annotated[ArrayLike, _MATRIX3]) -> Array:
    """Rotation vectors (..., 3), at most pi long, of rotation matrices (..., 3, 3)."""
    return _map(_so3_log, R, 2, (3,))


@checked()
def rotation_angle(R: Annotated[ArrayLike, _MATRIX3]) -> Array:
    """Angles (...) in [0, pi] of rotation matrices (..., 3, 3)."""
    return np.asarray(np.linalg.norm(so3_log(R), axis=-1))


@checked()
def hat(w: Annotated[ArrayLike, _VECTOR3]) -> Array:
    """Cross-product matrices (..., 3, 3): ``hat(w) @ x = cross(w, x)``."""
    columns = np.cross(np.asarray(w)[..., None, :], np.eye(3))
    return np.asarray(columns.swapaxes(-1, -2))


@checked()
def quaternions(X: Annotated[ArrayLike, _POSES]) -> Array:
    """Unit quaternions wxyz (..., 4), ``w >= 0``, of poses (..., 4, 4)."""
    return _map(_quaternions, X, 2, (4,))


@checked()
def rotations(wxyz: Annotated[ArrayLike, _QUATERNIONS]) -> Array:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4) of any length."""
    return _map(_rotations, wxyz, 1, (3, 3))


@checked()
def perpendiculars(z: Annotated[Array, _VECTOR3]) -> tuple[Array, Array]:
    """Unit vectors x and y that make right-handed frames with unit vectors z, (..., 3) each.

    x is perpendicular to the coordinate axis that is farthest from z, too.
    """
    x = np.cross(z, np.eye(3)[np.argmin(np.abs(z), axis=-1)])
    x /= np.linalg.norm(x, axis=-1, keepdims=True) if z.ndim > 1 else np.linalg.norm(x)
    return x, np.cross(z, x)


@checked()
def make_pose(R: Annotated[ArrayLike, _MATRIX3], p: Annotated[ArrayLike, _VECTOR3]) -> Array:
    """Poses (..., 4, 4) from rotations (..., 3, 3) and positions (..., 3), broadcast together."""
    R, p = np.asarray(R), np.asarray(p)
    try:
        lead = np.broadcast_shapes(R.shape[:-2], p.shape[:-1])
    except ValueError:
        raise ArgumentError(
            f"make_pose: R has shape {R.shape} and p {p.shape}; give as many of both, or one of one"
        ) from None
    X = np.zeros((*lead, 4, 4))
    X[..., :3, :3] = R
    X[..., :3, 3] = p
    X[..., 3, 3] = 1.0
    return X


@checked()
def random_pose(rng: np.random.Generator, n: Whole) -> Array:
    """Poses (n, 4, 4) with uniform rotations and positions uniform in [-1, 1]^3 m."""
    # A 4-vector of normal variates is a uniform direction, hence a uniform unit quaternion.
    q = rng.standard_normal((n, 4))
    return make_pose(rotations(q), rng.uniform(-1.0, 1.0, (n, 3)))


@checked()
def extrapolate(
    X_WB: Annotated[ArrayLike, _POSE], V_WB: Annotated[ArrayLike, _TWIST], dt: float
) -> Array:
    """Pose (4, 4) of a body B after ``dt`` [s] at the twist V_WB (6,), that of its origin.

    The origin moves straight while B turns about it.
    """
    X, V = np.array(X_WB, dtype=float), np.asarray(V_WB, dtype=float)
    X[:3, :3] = so3_exp_kernel(V[:3] * dt) @ X[:3, :3]
    X[:3, 3] += V[3:] * dt
    return X


@checked()
def interpolate(
    X_WA: Annotated[ArrayLike, _POSE], X_WB: Annotated[ArrayLike, _POSE], share: float
) -> Array:
    """Pose (4, 4) on the screw from A to B, ``X_WA exp(share log(X_AB))``: 0 is A, 1 is B.

    B is less than half a turn away.
    """
    X_AB = inverse(X_WA) @ np.asarray(X_WB)
    return np.asarray(np.asarray(X_WA) @ exp(share * log(X_AB)))


def _map(
    loop: Callable[[Array, Array], None], array: ArrayLike, axes: int, out_shape: tuple[int, ...]
) -> Array:
    """Runs a compiled loop over the flattened leading axes of the input, all but the last axes."""
    array = np.asarray(array)
    lead, shape = array.shape[:-axes], array.shape[-axes:]
    out = np.empty((int(np.prod(lead)), *out_shape))
    loop(array.reshape(len(out), *shape), out)
    return out.reshape(*lead, *out_shape)


# One loop per kernel: numba's on-disk cache does not recognise kernels passed as arguments.


@compiled
def _exp(v: Array, out: Array) -> None:
    for i in range(len(v)):
        out[i] = exp_kernel(v[i])


@compiled
def _log(X: Array, out: Array) -> None:
    for i in range(len(X)):
        out[i] = log_kernel(X[i])


@compiled
def _inverse(X: Array, out: Array) -> None:
    for i in range(len(X)):
        out[i] = inverse_kernel(X[i])


@compiled
def _right_jacobian_inverse(v: Array, out: Array) -> None:
    for i in range(len(v)):
        out[i] = right_jacobian_inverse_kernel(v[i])


@compiled
def _so3_exp(w: Array, out: Array) -> None:
    for i in range(len(w)):
        out[i] = so3_exp_kernel(w[i])


@compiled
def _so3_log(R: Array, out: Array) -> None:
    for i in range(len(R)):
        out[i] = so3_log_kernel(R[i])


@compiled
def _quaternions(X: Array, out: Array) -> None:
    for i in range(len(X)):
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = quaternion_kernel(X[i])


@compiled
def _rotations(q: Array, out: Array) -> None:
    for i in range(len(q)):
        rotation_kernel(q[i], out[i])
