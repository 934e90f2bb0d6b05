"""Search poses: configurations from which the wrist camera searches a lost object.

The camera draws back from where the object is expected, and turns there; if nothing shows, the view
circles that place, wider and wider. After `_HOME_AFTER` it looks from the home configuration, if
that is admissible: an object that moves to and fro comes into that view by itself.

The poses that show the place are many: from where the camera is or from nearer to the base, at any
turn about its axis. The arm goes to the one that it is soonest at; where it cannot be at any, the
camera looks from all round the place, and from nearer and farther.
"""

from dataclasses import dataclass

import numpy as np

from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics

#: An object that was not seen for so long is looked for [s]. Source: guessed.
SEARCH_AFTER = 0.25
#: Distance of the camera from what it looks for [m]. Source: guessed.
_DISTANCE = 0.38
#: Directions and distances [m] to look from where none of these can be reached. Source: guessed.
_ALL_ROUND, _DISTANCES = sphere_points(24, 1.0), (0.3, _DISTANCE, 0.46)
#: The view circles an object that has been out of sight so long [s], once in so long [s],
#: so quickly farther out [rad/s]; after so long the arm looks from home [s]. Source: guessed.
_CIRCLES_AFTER, _CIRCLE_PERIOD, _WIDENS, _HOME_AFTER = 1.5, 4.0, 0.08, 5.0


@dataclass(frozen=True, eq=False)
class SearchTarget(Frozen):
    """A lost object with its expected pose.

    Attributes:
        X_WO: Where it is expected, shape (4, 4) [m].
        age: How long it has been out of sight [s].
    """

    X_WO: Array
    age: float

    def __post_init__(self) -> None:
        self._freeze(X_WO=np.array(self.X_WO, dtype=float))


def search_configuration(
    search_target: SearchTarget, q: Array, X_WC: Array, reachability: Reachability
) -> Array | None:
    """Configuration (7,) [rad] from which the wrist camera searches an object; None without one.

    The joints are at ``q`` (7,) [rad], the camera, which is on the hand, at ``X_WC`` (4, 4), z
    forward.
    """
    home = reachability.arm.home
    if search_target.age > _HOME_AFTER and reachability.admissible(home[None])[0]:
        return home
    p_W = search_target.X_WO[:3, 3]
    X_WH = forward_kinematics(q, reachability.gripper.X_FG, reachability.arm)
    X_CH = se3.inverse(X_WC) @ X_WH
    for sides, distances in (
        (_usual_sides(p_W, X_WC, reachability.arm), (_DISTANCE,)),
        (_ALL_ROUND, _DISTANCES),
    ):
        z_W = _aside(-sides, search_target.age)
        p_WC = p_W + np.array(distances)[:, None, None] * sides
        views = _turned_views(p_WC, np.broadcast_to(z_W, p_WC.shape), X_WC).reshape(-1, 4, 4)
        found, times = reachability.nearest(views @ X_CH, q)
        best = int(np.argmin(times))
        if np.isfinite(times[best]):
            return found[best]
    return None


def _turned_views(p_WC: Array, z_W: Array, X_WC: Array) -> Array:
    """Poses (..., m, 4, 4) of a camera at p (..., 3) that looks along unit z (..., 3), at any turn.

    The first turn is the nearest to that of the camera at X_WC (4, 4).
    """
    across = X_WC[:3, 0] - (z_W @ X_WC[:3, 0])[..., None] * z_W
    x = _direction(across, se3.perpendiculars(z_W)[0])
    y, z = np.cross(z_W, x)[..., None, :], z_W[..., None, :]
    roll = np.linspace(0.0, 2.0 * np.pi, 6, endpoint=False)[:, None]
    turned = np.cos(roll) * x[..., None, :] + np.sin(roll) * y
    R_WC = np.stack([turned, np.cross(z, turned), np.broadcast_to(z, turned.shape)], axis=-1)
    return se3.make_pose(R_WC, p_WC[..., None, :])


def search_velocity(q: Array, q_search: Array, speed: float = 1.0, arm: Arm = IIWA_7) -> Array:
    """Synchronized joint velocity (7,) [rad/s] to a configuration, at a share of the limits."""
    # Share of the speed that joints have, rate at which the way left decreases [1/s]; guessed.
    way, share, gain = q_search - q, 0.5, 3.0
    time = float(np.max(np.abs(way) / (speed * share * arm.velocity_limits)))
    return np.asarray(min(gain, 1.0 / max(time, 1e-9)) * way)


def _usual_sides(p_W: Array, X_WC: Array, arm: Arm) -> Array:
    """Directions from a place to the camera, to the robot's shoulder, and between, shape (n, 3)."""
    to_camera = _direction(X_WC[:3, 3] - p_W, -X_WC[:3, 2])
    to_base = _direction(arm.points[1] - p_W, to_camera)
    share = np.array([[0.0], [0.4], [1.0]])  # guessed
    return _direction((1.0 - share) * to_camera + share * to_base, to_base)


def _aside(z: Array, age: float) -> Array:
    """Where is looked instead of along unit z (n, 3), after so long out of sight, shape (n, 3)."""
    circling = max(age - _CIRCLES_AFTER, 0.0)
    angle = _WIDENS * min(circling, _HOME_AFTER - _CIRCLES_AFTER)  # longer, if home is not free
    phase = 2.0 * np.pi * circling / _CIRCLE_PERIOD
    x, y = se3.perpendiculars(z)
    return np.asarray(np.cos(angle) * z + np.sin(angle) * (np.cos(phase) * x + np.sin(phase) * y))


def _direction(v: Array, otherwise: Array) -> Array:
    """Unit vectors along v (..., 3); another where v has no length."""
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.where(length > 1e-6, v / np.maximum(length, 1e-6), otherwise)
