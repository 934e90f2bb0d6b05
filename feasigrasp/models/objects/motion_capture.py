"""Error model of a motion-capture system."""

from __future__ import annotations

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.tracker_config import TrackerConfig


def measured_pose(X_WO: Array, time: float, config: TrackerConfig) -> Array | None:
    """Measurement of a motion-capture system at a time [s]; None for a lost one.

    Args:
        X_WO: The true pose, shape (4, 4).
        time: When; the errors depend on it and on the seed only.
        config: What the system is like.
    """
    if max(config.position_noise, config.rotation_noise, config.dropout) == 0.0:
        return X_WO
    rng = np.random.default_rng([config.seed, round(time / config.period)])
    lost = rng.random() < config.dropout
    noise = rng.standard_normal(6)
    X = X_WO.copy()
    X[:3, :3] = se3.so3_exp(config.rotation_noise * noise[:3]) @ X[:3, :3]
    X[:3, 3] += config.position_noise * noise[3:]
    return None if lost else X
