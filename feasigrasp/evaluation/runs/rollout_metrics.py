"""What a kinematic rollout is judged by: the metrics of every run, and what re-grips cost."""

from __future__ import annotations

from typing import Any

import numpy as np

from feasigrasp.evaluation.runs.grasp_tracking import TRACKED_ANGLE, TRACKED_POSITION
from feasigrasp.evaluation.runs.motion_limits import JointTicks
from feasigrasp.evaluation.runs.run_metrics import METRICS, Metric, summarize
from feasigrasp.models.arrays import Array
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.systems.metrics import SAMPLE_NAMES

#: Every metric of a rollout.
ROLLOUT_METRICS: dict[str, Metric] = METRICS | {"regrip_cost_cm": Metric("cm")}


def rollout_metrics(samples: Array, states: Array, period: float) -> dict[str, Any]:
    """The metrics of a run that never closes the gripper.

    ``regrip_cost_cm`` is the mean distance of hand and object less the mean while a grasp is
    tracked: what the ways between grasps, unwinding included, add to the distance; None if none is
    ever tracked.

    Args:
        samples: One row per entry of `SAMPLE_NAMES`, shape (s, n).
        states: Joint positions and velocities at every control tick, shape (m, 14).
        period: Time between ticks [s].
    """
    x = dict(zip(SAMPLE_NAMES, samples, strict=True))
    qd = states[:, IIWA_7.joints :]
    distance = np.linalg.norm([x["p_HO_x"], x["p_HO_y"], x["p_HO_z"]], axis=0)
    close = x["grasp_position_error"] < TRACKED_POSITION
    tracked = close & (x["grasp_angle_error"] < TRACKED_ANGLE)
    cost = 100.0 * float(distance.mean() - distance[tracked].mean()) if tracked.any() else None
    ticks = JointTicks(commanded=qd, measured=qd, period=period)
    return summarize(samples, closes=False, ticks=ticks) | {"regrip_cost_cm": cost}
