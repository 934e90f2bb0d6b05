"""Expected error of the completed surface as a function of distance to observations.

The distance from the nearest observed point says nearly all about it: neither the full variance of
the Gaussian process nor what the hidden-side network expects of itself predicts the error better.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry.points import nearest_distance
from feasigrasp.models.shape.gpdf import Gpdf

#: Error of observed surface [m], and its growth with the distance from it.
_SEEN, _GROWTH = 0.0002, 0.21
#: Clearances grow by this share of the predicted deviation of the surface.
MARGIN_GROWTH = 0.5
#: Surface this far from all that was seen may not be there at all [m].
INVENTED = 0.010


def predicted_deviation(apart: ArrayLike) -> Array:
    """Expected distance of completed surface from the true one.

    The two coefficients are calibrated on the built-in objects (``feasigrasp evaluate shape`` draws
    how well they do on these and on others).

    Args:
        apart: Distance from the nearest observed point [m], any shape.

    Returns:
        The same shape [m].
    """
    return np.asarray(_SEEN + _GROWTH * np.asarray(apart))


def surface_deviation(field: Gpdf, x: Array) -> Array:
    """Expected distance of a field's surface at x (m, 3) from the true one, shape (m,) [m]."""
    return predicted_deviation(nearest_distance(np.ascontiguousarray(x), field.points))
