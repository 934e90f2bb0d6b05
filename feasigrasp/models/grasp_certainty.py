"""How likely a grasp of a completed surface is a grasp of the true one.

What the camera did not see was made up, so neither contacts nor clearances are certain. Both
probabilities here are logistic in what the distance field tells, with coefficients fitted to the
verdicts of true meshes (`feasigrasp.models.grasp_truth`) on objects that no evaluation uses. Their
product ranks grasps, and says how much is left to chance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from feasigrasp.models.gpdf_field import Gpdf
from feasigrasp.models.grasps import GraspSet
from feasigrasp.models.surface_error import surface_deviation

Array = NDArray[np.float64]

#: Distance from a contact to the surface points round it whose normals count as well [m]: the
#: completed surface is off by a few millimetres, and beside an edge another face is met.
PATCH_RADIUS = 0.004
#: Log odds of a pair of contacts that are seen and perfectly opposed; what each radian of both
#: normals, and each metre of both deviations, takes away.
_OPPOSED, _PER_RADIAN, _PER_METRE = 4.1, 5.0, 115.0
#: Error of a clearance: where the surface was seen [m], and per predicted deviation.
_CLEARANCE_ERROR, _DEVIATION_SHARE = 0.003, 0.67
#: Clearance in such errors at which the odds are even, and log odds per error beyond it.
_EVEN, _PER_ERROR = 0.6, 2.4
#: Log odds of a contact from those of a network and of the field: both have seen the same surface,
#: so they count less than independent witnesses would.
_BOTH, _OF_NETWORK, _OF_FIELD = -0.95, 0.93, 0.58
_CLOSE_TO_CERTAIN = 1e-4
#: Further away than this a hand is certainly free [m].
FAR = 0.012


def contact_certainty(gpdf: Gpdf, pairs: GraspSet) -> Array:
    """Probability that both pads meet true surface within the friction cone, shape (n,).

    It falls with the angle between closing line and surface normals, averaged over a patch round
    each contact, and with the predicted deviation of the surface there.
    """
    b, half = pairs.X_OG[:, :3, 0], 0.5 * pairs.width[:, None] * pairs.X_OG[:, :3, 0]
    first, second = pairs.X_OG[:, :3, 3] - half, pairs.X_OG[:, :3, 3] + half
    angles = _patch_angle(gpdf, first, -b, pairs) + _patch_angle(gpdf, second, b, pairs)
    deviations = surface_deviation(gpdf, first) + surface_deviation(gpdf, second)
    return _logistic(_OPPOSED - _PER_RADIAN * angles - _PER_METRE * deviations)


def joint_certainty(of_network: Array, of_field: Array) -> Array:
    """Probability of contacts by what a network and the field say of them, shapes (n,)."""
    return _logistic(_BOTH + _OF_NETWORK * _odds(of_network) + _OF_FIELD * _odds(of_field))


def mean_certainty(first: Array, second: Array) -> Array:
    """Probability with the mean log odds of two, shapes (n,)."""
    return _logistic(0.5 * (_odds(first) + _odds(second)))


def clearance_certainty(clearance: Array, deviation: Array) -> Array:
    """Probability that a hand is free of the true surface.

    Args:
        clearance: Least distance of the hand from the completed surface, shape (n,) [m].
        deviation: Predicted deviation of the surface where the hand is closest, shape (n,) [m].

    Returns:
        Shape (n,).
    """
    error = _CLEARANCE_ERROR + _DEVIATION_SHARE * deviation
    return _logistic(_PER_ERROR * (clearance / error - _EVEN))


def _patch_angle(gpdf: Gpdf, contact: Array, outward: Array, pairs: GraspSet) -> Array:
    """Mean angle between a direction and the normals of a patch round each contact (n,) [rad]."""
    y, z = pairs.X_OG[:, :3, 1], pairs.X_OG[:, :3, 2]
    around = np.stack([y, -y, z, -z], axis=1) * PATCH_RADIUS + contact[:, None]
    _, _, normals = gpdf.refine(around.reshape(-1, 3), 2)
    cosine = np.einsum("nki,ni->nk", normals.reshape(-1, 4, 3), outward)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)).mean(axis=1))


def _odds(probability: Array) -> Array:
    p = np.clip(probability, _CLOSE_TO_CERTAIN, 1.0 - _CLOSE_TO_CERTAIN)
    return np.asarray(np.log(p / (1.0 - p)))


def _logistic(x: Array) -> Array:
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(x, -50.0, 50.0))))
