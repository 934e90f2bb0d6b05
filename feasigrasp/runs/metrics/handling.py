"""Metrics of the object: displacement, premature contact, in-hand motion, grasp success."""

from dataclasses import dataclass

import numpy as np

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.sequence import Phase

#: An object is held that at the end, for this time [s], ... Source: definition.
HELD_FOR = 2.0
#: ... was closer than this to where it was in the hand when it was let go [m], [rad]. Source:
#: definition.
HELD_DISTANCE, HELD_ANGLE = 0.01, np.deg2rad(15.0)
#: The object starts at rest and has caught up with its path after this time [s]. Source: guessed.
ON_PATH_AFTER = 0.3


@dataclass(frozen=True, eq=False)
class ObjectTruth:
    """True object data of the simulation, beside the samples.

    Attributes:
        path: Where its motion would have it at every sample, shape (n, 4, 4) [m].
        contact: What `feasigrasp.systems.station.object_contact.ObjectContact` says at the end,
            shape (4,).
        let_go: When the carrier let it go [s]; infinite if it never did.
        touched: Whether arm or hand touched it at the end.
        broke_off: Whether the simulation failed.
    """

    path: Array
    contact: Array
    let_go: float
    touched: bool
    broke_off: bool


def displacement_metrics(
    X_WO: Array, X_WP: Array, approach: Mask, closing: Mask, period: float
) -> dict[str, float | None]:
    """Object displacement before closing, and while the fingers close.

    Args:
        X_WO: True pose of the object, shape (n, 4, 4) [m].
        X_WP: Where its motion would have it at the same time, shape (n, 4, 4).
        approach: Samples before closing, shape (n,); the first `ON_PATH_AFTER` seconds never count.
        closing: Samples from the start of closing to letting go, shape (n,).
        period: Time between samples [s].

    Returns:
        ``pushed_mm``, ``pushed_deg``, ``displaced_mm``, ``turned_deg``: the largest distance and
        angle of either samples; None without any.
    """
    distance, angle = _displacement(X_WO, X_WP)
    on_path = np.arange(len(approach)) * period >= ON_PATH_AFTER
    found: dict[str, float | None] = {}
    for counts, far, turned in (
        (approach & on_path, "pushed_mm", "pushed_deg"),
        (closing, "displaced_mm", "turned_deg"),
    ):
        found[far] = 1e3 * float(distance[counts].max()) if counts.any() else None
        found[turned] = float(np.rad2deg(angle[counts].max())) if counts.any() else None
    return found


def closing_speed(X_WP: Array, phase: Array, period: float) -> float | None:
    """Speed of the object on its path when the fingers last began to close [m/s]; else None.

    The path X_WP (n, 4, 4) and the `Phase` (n,) are sampled every ``period`` seconds.
    """
    began = np.flatnonzero((phase[1:] == Phase.CLOSE) & (phase[:-1] != Phase.CLOSE)) + 1
    if not len(began):
        return None
    velocity = np.gradient(X_WP[:, :3, 3], period, axis=0)
    return float(np.linalg.norm(velocity[began[-1]]))


def contact_metrics(contact: Array) -> dict[str, float | None]:
    """Premature contact: arm or hand with the object before closing.

    Args:
        contact: How long the hand approached, how long of it there was contact [s], the largest
            force [N], and the impulse of the contact force, shape (4,) [N s].

    Returns:
        ``contact_force_peak_n``, ``contact_impulse_n_s`` and ``contact_time_percent``, the latter
        None if the hand never approached.
    """
    time, touched, peak, impulse = contact.tolist()
    share = 100.0 * min(1.0, touched / time) if time > 0.0 else None
    names = ("contact_force_peak_n", "contact_impulse_n_s", "contact_time_percent")
    return dict(zip(names, (peak, impulse, share), strict=True))


def hold_metrics(
    X_HO: Array, p_WO: Array, phase: Array, period: float, lift: float = 0.0
) -> dict[str, float | bool | None]:
    """Whether the object was lifted and stayed in the hand after it was let go.

    Args:
        X_HO: True pose of the object in the hand, shape (n, 4, 4) [m].
        p_WO: Its origin in the world, z up, shape (n, 3) [m].
        phase: The `Phase`, shape (n,).
        period: Time between samples [s].
        lift: Commanded rise [m]; 0 if there is none.

    Returns:
        ``slip_mm``, ``turn_deg``: the largest displacement of the object's origin in the hand, and
        the largest rotation, since the object was let go, and ``lift_cm``: how much higher it ended
        than where it was let go; None if it never was. ``grasp_held``: whether the sequence went to
        its end, and the object has risen by half of the commanded lift and was at its place for
        the last `HELD_FOR` seconds; ``held_after_s``: if so, when it was let go.
    """
    released = phase > Phase.CLOSE
    if not released.any():
        return dict.fromkeys(("slip_mm", "turn_deg", "lift_cm", "held_after_s")) | {
            "grasp_held": False
        }
    start = int(np.argmax(released))
    distance, angle = _displacement(X_HO[start:], X_HO[start])
    last = slice(-1 - round(HELD_FOR / period), None)
    kept = np.all((distance[last] < HELD_DISTANCE) & (angle[last] < HELD_ANGLE))
    rise = float(p_WO[-1, 2] - p_WO[start, 2])
    lifted = lift <= 0.0 or rise >= 0.5 * lift
    held = bool(phase[-1] == Phase.DONE and kept and lifted)
    return {
        "grasp_held": held,
        "held_after_s": start * period if held else None,
        "slip_mm": 1e3 * float(distance.max()),
        "turn_deg": float(np.rad2deg(angle.max())),
        "lift_cm": 100.0 * rise,
    }


def _displacement(X_FA: Array, X_FB: Array) -> tuple[Array, Array]:
    """Distance of the origins [m] and angle [rad] between poses in one frame, shapes (n,)."""
    turn = np.swapaxes(X_FA[:, :3, :3], 1, 2) @ X_FB[..., :3, :3]
    return np.linalg.norm(X_FA[:, :3, 3] - X_FB[..., :3, 3], axis=1), se3.rotation_angle(turn)
