"""Three-vectors as tuples, for compiled loops."""

from feasigrasp.models.compiled import compiled, fused


@compiled(forceinline=True)
def dot(a, b):
    """Scalar product of two triples."""
    return fused(a[2], b[2], fused(a[1], b[1], a[0] * b[0]))


@compiled(forceinline=True)
def cross(a, b):
    """Vector product of two triples."""
    return (
        fused(a[1], b[2], -(a[2] * b[1])),
        fused(a[2], b[0], -(a[0] * b[2])),
        fused(a[0], b[1], -(a[1] * b[0])),
    )


@compiled(forceinline=True)
def minus(a, b):
    """The triple ``a - b``."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@compiled(forceinline=True)
def step(p, length, a):
    """The triple ``p + length a``."""
    return fused(length, a[0], p[0]), fused(length, a[1], p[1]), fused(length, a[2], p[2])


@compiled(forceinline=True)
def turn_frame(x, y, z, k, s, c):
    """A frame's axes turned about the direction ``k``, given in it, by a sine s and cosine c."""
    axis, d = step(step(step((0.0, 0.0, 0.0), k[0], x), k[1], y), k[2], z), 1.0 - c
    return (
        step(step(step((0.0, 0.0, 0.0), c, x), s, cross(axis, x)), d * k[0], axis),
        step(step(step((0.0, 0.0, 0.0), c, y), s, cross(axis, y)), d * k[1], axis),
        step(step(step((0.0, 0.0, 0.0), c, z), s, cross(axis, z)), d * k[2], axis),
    )


@compiled(forceinline=True)
def turn(x, y, s, c):
    """The axes ``x`` and ``y`` turned about the third by an angle of sine s and cosine c.

    In the order (x, y) the turn is about z, (z, x) about y, (y, z) about x.
    """
    return (
        (fused(c, x[0], s * y[0]), fused(c, x[1], s * y[1]), fused(c, x[2], s * y[2])),
        (fused(c, y[0], -(s * x[0])), fused(c, y[1], -(s * x[1])), fused(c, y[2], -(s * x[2]))),
    )
