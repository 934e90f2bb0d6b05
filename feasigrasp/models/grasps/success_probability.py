"""Calibrated success probability of grasps on a completed surface, by logistic regression.

What the camera did not see was made up, so neither contacts nor clearances are certain. The
probabilities here are logistic in features of the distance field and a network, with coefficients
fitted to the verdicts of true meshes (`feasigrasp_lab.training.data.grasp_truth`) on objects that
no training and no evaluation uses, by ``feasigrasp fit certainty``. Their product ranks grasps, and
says how much is left to chance.
"""

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.grasps.grasp_set import GraspSet, contacts
from feasigrasp.models.shape.gpdf import Gpdf, surface_deviation

#: Log odds that contacts are good: constant, per radian of both normals off the closing line, per
#: metre of both predicted deviations. Source: fitted: `feasigrasp fit certainty`.
CONTACT = (3.287, -4.141, -120.614)
#: The same by both witnesses: constant, per log odds of a network and of the field. Both have seen
#: the same surface, so they count less than independent ones would. Source: fitted: `feasigrasp fit
#: certainty`.
JOINT_CONTACT = (0.601, 0.45, 0.585)
#: In thin walls: constant, per log odds of a network, per metre of both predicted deviations.
#: Source: fitted: `feasigrasp fit certainty`.
THIN_CONTACT = (1.88, 0.671, -471.242)
#: Log odds that the hand is free: constant, per clearance in units of its error. Source: fitted:
#: `feasigrasp fit certainty`.
CLEARANCE = (0.644, 0.898)
#: The same by both witnesses, as `JOINT_CONTACT`. Source: fitted: `feasigrasp fit certainty`.
JOINT_CLEARANCE = (0.256, 0.375, 0.422)
#: The same where the field has no data: constant, per log odds of a network. Source: fitted:
#: `feasigrasp fit certainty`.
UNOBSERVED_CLEARANCE = (1.044, 0.201)


def contact_evidence(gpdf: Gpdf, pairs: GraspSet) -> tuple[Array, Array]:
    """Features of contacts from the field, summed over both contacts.

    Angle between closing line and surface normals, averaged over a patch round each contact, (n,)
    [rad], and predicted deviation of the surface there, (n,) [m].
    """
    b = pairs.X_OG[:, :3, 0]
    first, second = contacts(pairs)
    angles = _patch_angle(gpdf, first, -b, pairs) + _patch_angle(gpdf, second, b, pairs)
    return angles, surface_deviation(gpdf, first) + surface_deviation(gpdf, second)


def contact_probability(
    angles: Array, deviations: Array, learned: Array | None, thin: Mask
) -> Array:
    """Probability that contacts are good, shape (n,), by their `contact_evidence`.

    It is weighed with that of a network, (n,), if there is one; in ``thin`` walls it replaces the
    normals.
    """
    of_field = probability(CONTACT, angles, deviations)
    if learned is None:
        return of_field
    joint = probability(JOINT_CONTACT, odds(learned), odds(of_field))
    return np.where(thin, probability(THIN_CONTACT, odds(learned), deviations), joint)


def free_probability(
    clearance: Array, deviation: Array, learned: ArrayLike = np.nan, unobserved: ArrayLike = False
) -> Array:
    """Probability that a hand is free, shape (n,), by its `clearance_evidence`.

    It is weighed with that of a network, (n,), NaN where there is none; of hands that collide with
    ``unobserved`` surface alone, it is by the network's alone.
    """
    certain = probability(CLEARANCE, clearance_evidence(clearance, deviation))
    joint = probability(JOINT_CLEARANCE, odds(learned), odds(certain))
    certain = np.where(np.isnan(learned), certain, joint)
    return np.where(unobserved, probability(UNOBSERVED_CLEARANCE, odds(learned)), certain)


def clearance_evidence(clearance: Array, deviation: Array) -> Array:
    """Clearances of the hand in units of their errors, shape (n,); see `hand_clearance`."""
    # Error of a clearance: where the surface was seen [m], and per predicted deviation.
    clearance_error, deviation_share = 0.003, 0.67
    return clearance / (clearance_error + deviation_share * deviation)


def odds(p: ArrayLike) -> Array:
    """Log odds of probabilities (n,)."""
    # Probabilities are kept this far from 0 and 1. Source: numerical.
    least_probability = 1e-4
    p = np.clip(p, least_probability, 1.0 - least_probability)
    return np.asarray(np.log(p / (1.0 - p)))


def probability(coefficients: tuple[float, ...], *evidence: Array) -> Array:
    """Logistic regression on features (n,), with coefficients such as `CONTACT`."""
    constant, *slopes = coefficients
    x = constant + sum(slope * part for slope, part in zip(slopes, evidence, strict=True))
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(x, -50.0, 50.0))))


def _patch_angle(gpdf: Gpdf, contact: Array, outward: Array, pairs: GraspSet) -> Array:
    """Mean angle between a direction and the normals of a patch round each contact (n,) [rad]."""
    y, z = pairs.X_OG[:, :3, 1], pairs.X_OG[:, :3, 2]
    # Distance from a contact to the surface points round it whose normals count as well [m]: the
    # completed surface is off by a few millimetres, and beside an edge another face is met.
    around = np.stack([y, -y, z, -z], axis=1) * 0.004 + contact[:, None]
    _, _, normals = gpdf.refine(around.reshape(-1, 3), 2)
    cosine = np.einsum("nki,ni->nk", normals.reshape(-1, 4, 3), outward)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)).mean(axis=1))
