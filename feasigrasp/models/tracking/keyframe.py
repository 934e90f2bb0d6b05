"""Keyframes: selection of the views that are merged into the model."""

from dataclasses import dataclass, replace

import numpy as np

from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.clouds.checks import ViewRecord
from feasigrasp.models.clouds.edges import Outline
from feasigrasp.models.tracking.registration import Registration
from feasigrasp.models.tracking.view import ObjectView

#: A side this far from all observed ones [rad] is taken as soon as possible: once nothing that is
#: known is in the image any more, it is too late. Source: guessed.
_OTHER_SIDE = np.deg2rad(30.0)
#: Time between keyframes at least [s]; views of one side that suffice. Source: guessed.
KEY_PERIOD, KEY_VIEWS = 0.09, 10


@dataclass(frozen=True, eq=False)
class Keyframe(Frozen):
    """A view that is worth merging.

    Attributes:
        points_O: Points of the object in O, shape (n, 3) [m].
        p_OC: Position of the camera in O, shape (3,) [m].
        time: Of the image [s].
        deviation: How far the surface may be from there, across itself [m].
        begun_at: Time of the first view of this O [s]: what is older is of another one.
        outline: Where the object may go on beside the points, in O; None where that is unknown.
    """

    points_O: Array
    p_OC: Array
    time: float
    deviation: float = 0.0
    begun_at: float = -np.inf
    outline: Outline | None = None


def keyframe_of(
    view: ObjectView, X_WO: Array, time: float, deviation: float = 0.0, begun_at: float = -np.inf
) -> Keyframe:
    """A view of an object at X_WO (4, 4) as a `Keyframe`.

    It has no outline yet: most keyframes are looked at and not merged.
    """
    # Largest number of points of a keyframe: what more there are of a near object are closer
    # together than the model is fine.
    points_W = view.points_W[:: -(-len(view.points_W) // 6000)]
    p_OC = _in_object(X_WO, view.X_WC[:3, 3])
    return Keyframe(_in_object(X_WO, points_W), p_OC, time, deviation, begun_at)


def outlined(key: Keyframe, view: ObjectView, X_WO: Array) -> Keyframe:
    """A keyframe with the outline of its view, in which the object has the pose X_WO (4, 4)."""
    found = view.outline()
    if found is None:
        return key
    return replace(key, outline=found.turned(X_WO[:3, :3].T @ view.X_WC[:3, :3]))


def is_worth_merging(key: Keyframe, found: Registration, last: float, views: ViewRecord) -> bool:
    """Whether a view is accurate and informative enough for a keyframe.

    It fits the model as ``found`` says; the last keyframe was taken at ``last`` [s], at least
    `KEY_PERIOD` ago, and the merged ones from ``views``.
    """
    # Views of a side after which its keyframes are fewer, the time between these, and that after
    # which it is looked at again [s].
    known_side, known_period, revisit = 3, 0.4, 5.0
    # A view of which so much is new is taken as one of another side is.
    new_part = found.new > 0.25
    other = new_part or views.turned(key.p_OC) > _OTHER_SIDE
    # A keyframe of another side, or of a known one: least share of the known surface that it shows,
    # least share of its points on the model, and largest standard deviation of its surface [m]; of
    # either, less than this share of the model is beside the object.
    in_view, inliers, deviation = (0.35, 0.75, 2.5e-3) if other else (0.7, 0.85, 1.6e-3)
    reliable = found.inliers > inliers and found.beside < 0.1
    if not (reliable and found.in_view > in_view and key.deviation < deviation):
        return False
    if new_part or views.adds_information(key.p_OC, key.time, known_side, revisit):
        return True
    late = key.time >= last + known_period
    return late and views.adds_information(key.p_OC, key.time, KEY_VIEWS, revisit)


def cut_off(known: Array, view: ObjectView, X_WO: Array) -> Array:
    """Points (l, 3) of the surface that image borders cut off, after one more view.

    Of such points before it, shape (k, 3), and the object's pose X_WO (4, 4) in it; all points are
    in O [m].
    """
    known_W = known @ X_WO[:3, :3].T + X_WO[:3, 3]
    # They are cut off until an image shows a margin of this width around them [px].
    known = known[view.camera.to_border(view.in_camera(known_W)) < 12.0]
    found = _in_object(X_WO, view.points_W[view.at_border])
    # Numbers of points that are kept of an image, and of all.
    some = found[:: max(1, -(-len(found) // 60))]
    return np.concatenate([known, some])[-600:]


def _in_object(X_WO: Array, points_W: Array) -> Array:
    return np.asarray((points_W - X_WO[:3, 3]) @ X_WO[:3, :3])
