"""What a URDF leaves open about an arm: home, mounting of the hand, pairs that can collide."""

from itertools import combinations, product

import numpy as np
from scipy.optimize import least_squares

from feasigrasp.models.arrays import Array
from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.capsule_kernels import closest_parameters
from feasigrasp.models.robot.capsules import HAND_NAMES, capsule_model, hand_capsules
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.kinematics import forward_kinematics, manipulability

#: Bodies that touch in a larger share of configurations are taken to be built so; those that never
#: come nearer than the second need no check [m]. Source: guessed.
_BUILT_SO, _NEVER_NEAR = 0.2, 0.02
#: Of the hand at home: place on an arm of 0.9 m [m], and approach direction. Source: guessed.
_HOME, _APPROACH, _REACH = np.array([0.22, 0.0, 0.73]), np.array([0.82, 0.0, -0.57]), 0.9


def chosen_home(arm: Arm) -> Array:
    """The most manipulable configuration found with the hand in front of the arm, shape (n,).

    Where the wrist cannot be so near the first axis, the hand is farther out.
    """
    X_FG, n = ParallelGripper().X_FG, arm.joints
    lower, upper = arm.turns[0] + 0.2, arm.turns[1] - 0.2
    middle, starts = 0.5 * (lower + upper), np.random.default_rng(0).uniform(size=(40, n))
    for out in (0.0, 0.08, 0.16):
        place = (_HOME + [out, 0.0, 0.5 * out]) * min(1.0, arm.reach / _REACH)

        def error(q: Array, place: Array = place) -> Array:
            X_WG = forward_kinematics(q, X_FG, arm)
            way, turn = X_WG[:3, 3] - place, 0.5 * (X_WG[:3, 2] - _APPROACH)
            return np.concatenate([way, turn, 1e-3 * (q - middle), 1e-2 * q[:1]])

        found = []
        for start in lower + starts * (upper - lower):
            q = least_squares(error, start, bounds=(lower, upper)).x
            room = float(np.min(np.minimum(q - lower, upper - q)))
            if np.abs(error(q)[:6]).max() < 0.03:
                worth = float(manipulability(q, arm)) * min(1.0, room / 0.3) - abs(q[0])
                found.append((worth, q.tolist()))
        if found:
            return np.array(max(found)[1])
    return middle


def camera_above(arm: Arm) -> Array:
    """The flange frame (4, 4) at q = 0, turned about its z-axis so that the camera is above."""
    R = forward_kinematics(arm.home, None, arm)[:3, :3]
    down = np.array([0.0, 0.0, -1.0]) - 0.1 * np.array([1.0, 0.0, 0.0])
    angle = float(np.arctan2(R[:, 1] @ down, R[:, 0] @ down))
    quarter = np.pi / 4.0  # mounts have holes at such angles
    c, s = np.cos(round(angle / quarter) * quarter), np.sin(round(angle / quarter) * quarter)
    X_WF = arm.X_WF.copy()
    X_WF[:3, :3] = X_WF[:3, :3] @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return X_WF


def close_pairs(arm: Arm) -> list[tuple[int, int]]:
    """Pairs of bodies that come close, of 1,000 configurations, and do not touch in most."""
    n = arm.joints
    hand = range(n + 1, n + 1 + len(HAND_NAMES))
    # No joint connects them, nor two with a link between them.
    apart = [(a, b) for a, b in combinations(range(n + 1), 2) if b - a > 2]
    possible = [*apart, *product(range(n - 1), hand)]
    model = capsule_model(None, arm, body_pairs=possible)
    bodies = [capsule.body for capsule in arm.capsules + hand_capsules(None, arm)]
    Q = arm.random_positions(np.random.default_rng(0), 1000)
    gaps: dict[tuple[int, int], list[float]] = {pair: [] for pair in possible}
    for q in Q:
        points = [tuple(map(tuple, pair)) for pair in model.placed(q).tolist()]
        close: dict[tuple[int, int], float] = {}
        for i, j in model.pairs.tolist():
            d = closest_parameters(*points[i], *points[j])[2]
            pair = bodies[i], bodies[j]
            gap = float(np.linalg.norm(d)) - model.radius[i] - model.radius[j]
            close[pair] = min(gap, close.get(pair, np.inf))
        for pair, gap in close.items():
            gaps[pair].append(gap)
    return [
        pair
        for pair, found in gaps.items()
        if min(found, default=np.inf) < _NEVER_NEAR
        and sum(gap < 0.0 for gap in found) < _BUILT_SO * len(Q)
    ]
