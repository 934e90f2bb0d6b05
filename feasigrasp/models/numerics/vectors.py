"""Vectors of three as tuples: compiled code keeps them in registers and vectorises over them."""

from numba import njit


@njit(cache=True, fastmath={"contract"}, forceinline=True)
def dot(a, b):
    """Scalar product of two triples."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, fastmath={"contract"}, forceinline=True)
def cross(a, b):
    """Vector product of two triples."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True, forceinline=True)
def minus(a, b):
    """The triple ``a - b``."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@njit(cache=True, fastmath={"contract"}, forceinline=True)
def step(p, length, a):
    """The triple ``p + length a``."""
    return p[0] + length * a[0], p[1] + length * a[1], p[2] + length * a[2]


@njit(cache=True, fastmath={"contract"}, forceinline=True)
def turn(x, y, s, c):
    """The axes ``x`` and ``y`` turned about the third by an angle of sine s and cosine c.

    In the order (x, y) the turn is about z, (z, x) about y, (y, z) about x.
    """
    return (
        (c * x[0] + s * y[0], c * x[1] + s * y[1], c * x[2] + s * y[2]),
        (c * y[0] - s * x[0], c * y[1] - s * x[1], c * y[2] - s * x[2]),
    )
