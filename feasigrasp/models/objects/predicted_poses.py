"""Predicted object poses over the prediction horizon."""

from enum import StrEnum

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.objects.prediction import Motion, future_poses


class PredictionModel(StrEnum):
    """Motion model of the object in a plan."""

    PREDICTED = "predicted"  # to go on as the tracker predicts
    TWIST = "twist"  # to keep its twist
    NONE = "none"  # to stay where it is


def predicted_poses(
    prediction: str, motion: Motion | None, X_WO: Array, V_WO: Array, times: Array
) -> Array:
    """Poses (k, 4, 4) of the object that a plan is made for.

    Args:
        prediction: A `PredictionModel`.
        motion: What is known of its motion; without it the object keeps its twist at best.
        X_WO: Pose now, shape (4, 4).
        V_WO: Twist now [angular; linear], shape (6,).
        times: From now on, shape (k,) [s].
    """
    if prediction == PredictionModel.NONE:
        return np.tile(X_WO, (len(times), 1, 1))
    known = motion if prediction == PredictionModel.PREDICTED else None
    return np.ascontiguousarray(future_poses(known, X_WO, V_WO, times))
