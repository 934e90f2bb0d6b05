"""An arctangent of two arguments that compilers can vectorise.

``math.atan2`` inside ``@njit`` is a scalar call and keeps the whole loop around it scalar, see
`feasigrasp.models.numerics.fast_math`. The one below has no branches: the ratio of the smaller to
the larger argument is turned by 45 degrees where it exceeds tan(22.5 deg), so that ``|t| <=
tan(22.5 deg)``; there ``atan(t) / t`` is a polynomial in ``t^2``.
"""

import numpy as np
from numba import njit
from numpy.polynomial import Chebyshev, Polynomial

_TAN_PI_8 = float(np.sqrt(2.0) - 1.0)
_PI, _PI_2, _PI_4 = float(np.pi), float(np.pi / 2), float(np.pi / 4)
_TINY = 1e-300  # keeps 0 / 0 away; atan2(0, 0) is 0


def _quotient(z: np.ndarray) -> np.ndarray:
    t = np.sqrt(z)
    return np.arctan(t) / t


# Interpolation at 13 Chebyshev nodes: remainder below 1e-17, since the nearest singularity of
# atan(sqrt z) / sqrt z lies at z = -1.
_POLYNOMIAL = Chebyshev.interpolate(_quotient, 12, [0.0, _TAN_PI_8**2]).convert(kind=Polynomial)
_C0, _C1, _C2, _C3, _C4, _C5, _C6, _C7, _C8, _C9, _C10, _C11, _C12 = (
    float(c) for c in _POLYNOMIAL.coef
)


@njit(cache=True, fastmath={"contract", "nsz"}, error_model="numpy", inline="always")
def fast_atan2(y: float, x: float) -> float:
    """``atan2(y, x)`` for finite arguments, within 1e-15; in (-pi, pi], 0 at the origin.

    The sign of a zero is not looked at: ``fast_atan2(-0.0, -1.0)`` is ``pi``.
    """
    ax, ay = abs(x), abs(y)
    low, high = min(ax, ay), max(ax, ay)
    turned = low > _TAN_PI_8 * high
    numerator = low - high if turned else low
    denominator = low + high if turned else high
    t = numerator / max(denominator, _TINY)
    z = t * t
    p = _C11 + z * _C12
    p = _C10 + z * p
    p = _C9 + z * p
    p = _C8 + z * p
    p = _C7 + z * p
    p = _C6 + z * p
    p = _C5 + z * p
    p = _C4 + z * p
    p = _C3 + z * p
    p = _C2 + z * p
    p = _C1 + z * p
    p = _C0 + z * p
    angle = t * p + (_PI_4 if turned else 0.0)
    angle = _PI_2 - angle if ay > ax else angle
    angle = _PI - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle
